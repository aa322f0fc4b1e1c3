"""Test that the processes of a robot find a user's class in any location, or that it is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from strands_actors.drivers.plain.class_location import load_class, location_of_class
from strands_actors.drivers.plain.driver import PlainDriver
from strands_actors.supervisors.loading import describe_driver, load_driver, without_secrets

from .small_arm import DeclaredArmDriver, SmallArmDriver

SCRIPT = """
import sys
from strands_actors import Robot, register_native_driver, register_robot
from tests.drivers.plain.small_arm import DeclaredArmDriver

class Mine(DeclaredArmDriver):
    pass

{guard}
    register_robot("mine")
    register_native_driver("mine", Mine)
    robot = Robot("mine", mode="real", port=sys.argv[1])
    print(robot.connect_eagerly())
    print(robot.get_observation())
    robot.cleanup()
"""


def run(script: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    command = [sys.executable, str(script), *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=60, check=False)


def test_a_class_is_loaded_by_its_module() -> None:
    location = location_of_class(DeclaredArmDriver)
    assert (location.module, location.name, location.script) == (
        "tests.drivers.plain.small_arm",
        "DeclaredArmDriver",
        "",
    )
    assert Path(location.folder) == Path(__file__).resolve().parents[3]
    assert load_class(location) is DeclaredArmDriver


def test_a_class_within_a_function_is_refused() -> None:
    class Local(DeclaredArmDriver):
        pass

    with pytest.raises(ValueError, match="is defined in a function"):
        location_of_class(Local)


def test_keywords_that_cannot_travel_are_refused() -> None:
    with pytest.raises(
        ValueError, match=r"data_config is <object .*cannot be sent to the process of DeclaredArmDriver"
    ):
        PlainDriver.options_of(DeclaredArmDriver, "mine", {"data_config": object()})
    options = PlainDriver.options_of(DeclaredArmDriver, "mine", {"data_config": (1, "a")})
    assert options["config"]["keywords"] == {"data_config": (1, "a")}


def test_passwords_are_in_no_recording_and_no_certificate() -> None:
    given = {"tool_name": "left", "password": "hunter2", "api_token": "abc", "level": 3}
    options = PlainDriver.options_of(SmallArmDriver, "mine", given)
    assert PlainDriver("mine", "", options).config.keywords == given
    description = describe_driver(PlainDriver, "mine", "", options)
    shown = without_secrets(description, PlainDriver)
    assert "hunter2" not in repr(shown) and "abc" not in repr(shown)
    assert load_driver(shown).config.keywords == {"tool_name": "left", "level": 3}


def test_a_class_in_the_script_itself_runs(small_port: str, tmp_path: Path) -> None:
    script = tmp_path / "mine.py"
    script.write_text(SCRIPT.format(guard='if __name__ == "__main__":'))
    done = run(script, small_port)
    assert done.stdout.splitlines() == ["None", "{'pan': 1.5, 'lift': -2.5}"], done.stderr


def test_a_script_that_would_run_again_as_a_whole_is_refused(small_port: str, tmp_path: Path) -> None:
    script = tmp_path / "mine.py"
    script.write_text(SCRIPT.format(guard="if True:"))
    done = run(script, small_port)
    assert done.returncode == 1
    assert "Mine is defined in mine.py, and another process would run this script" in done.stderr


def test_a_script_that_makes_its_robot_when_it_is_loaded_ends(small_port: str, tmp_path: Path) -> None:
    script = tmp_path / "mine.py"
    script.write_text(SCRIPT.format(guard="if True:") + '\nif __name__ == "__main__":\n    pass\n')
    done = run(script, small_port)
    assert "Robot: the file of Mine calls Robot() while it is imported" in done.stdout

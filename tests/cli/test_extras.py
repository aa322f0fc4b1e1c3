"""Without the extras, robots and simulations run. A function that needs an extra names the command that
installs it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from .command import PATIENCE_S, Command

HIDDEN = (
    "matplotlib",
    "textual",
    "mcap",
    "zstandard",
    "OpenGL",
    "glfw",
    "mcp",
    "rtde_receive",
    "rtde_control",
    "pyarrow",
    "av",
)


@pytest.fixture
def lean(cli: Command, tmp_path: Path) -> Command:
    """Give the command as if only the core were installed: no process can import the extras."""
    hide = f"import sys\nsys.modules.update(dict.fromkeys({HIDDEN!r}))\n"
    (tmp_path / "sitecustomize.py").write_text(hide)
    cli.environment["PYTHONPATH"] += f":{tmp_path}"
    return cli


def script(command: Command, text: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", text],
        env=command.environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_simulation_runs_and_a_picture_names_its_extra(lean: Command) -> None:
    output = script(
        lean,
        """
from strands_actors import Robot
with Robot("so101") as arm:
    print(arm.send_action({"shoulder_pan": 10.0})["status"])
    try:
        arm.render(64, 48)
    except RuntimeError as why:
        print(why)
    try:
        arm.video("run.mp4")
    except RuntimeError as why:
        print(why)
""",
    )
    assert output.splitlines()[0] == "success"
    assert "a picture needs OpenGL and glfw. pip install 'strands-actors[pictures]'" in output
    lacking = "pyarrow and av. pip install 'strands-actors[dataset]', or give a name that ends with .gif"
    assert f"video: a film as .mp4 needs {lacking}" in output


def test_a_ur_runs_without_its_sdk_and_names_the_command_that_installs_it(lean: Command) -> None:
    output = script(
        lean,
        """
from strands_actors import Robot
arm = Robot("ur5e", mode="real", transport="twin", control="ur-rtde")
print(arm.connect_eagerly())
arm.cleanup()
arm = Robot("ur5e", mode="real", transport="twin")
print(arm.connect_eagerly(), arm.get_status()["content"][0]["json"]["commanded_by"])
arm.cleanup()
with Robot("ur5e") as arm:
    print(arm.send_action({"shoulder_pan_joint": 0.1})["status"])
""",
    )
    refusal, connected, status = output.splitlines()
    assert "rtde_control cannot be used" in refusal
    assert "pip install 'strands-actors[ur]'" in refusal or "has no wheel for" in refusal
    assert connected == "None script"
    assert status == "success"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("replay", "run.mcap"), "a recording needs mcap and zstandard. pip install 'strands-actors[record]'"),
        (("record", "so101", "-o", "run.mcap"), "pip install 'strands-actors[record]'"),
        (
            ("record", "so101", "--dataset", "set", "--task", "wave"),
            "a dataset needs pyarrow and av. pip install 'strands-actors[dataset]'",
        ),
        (("mcp", "so101"), "mcp needs mcp. pip install 'strands-actors[mcp]'"),
    ],
)
def test_a_command_names_its_extra(lean: Command, arguments: tuple[str, ...], message: str) -> None:
    done = lean.run(*arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_the_import_of_record_names_its_extra(lean: Command) -> None:
    output = script(
        lean,
        """
from strands_actors import record
try:
    record("so101", "run.mcap")
except ImportError as why:
    print(why)
""",
    )
    assert "pip install 'strands-actors[record]'" in output


@pytest.mark.long
def test_the_demo_runs_without_its_picture(lean: Command, tmp_path: Path) -> None:
    done = lean.run("demo", "--no-faults", "--seconds", "6", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "pip install 'strands-actors[demo]'" in done.stdout
    assert not (tmp_path / "demo.png").exists()


def test_doctor_names_the_requirements_of_pictures(lean: Command) -> None:
    checks = lean.json("doctor")["checks"]
    (gl,) = [check for check in checks if check["name"] == "gl"]
    assert gl["state"] == "note"
    assert gl["remedy"] == "pip install 'strands-actors[pictures]'"

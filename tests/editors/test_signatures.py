"""The signatures of ``Robot(...)`` for editors and type checkers. mypy reports mistakes and accepts correct
calls. jedi, the completion of IPython and many editors, offers the keywords."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import jedi
import pytest

from tests.covered import unmeasured
from tests.house.test_imports import ROOT
from tests.house.test_public import BLOCK

from . import signatures

BEGIN = "from strands_actors import Robot, open_robot"

MISTAKES = (
    'Robot("so101", mode="reel")',
    'Robot("so101", mode="real", prt="x")',
    'Robot("so101", mode="real", port=3)',
    'Robot("so101", mode="real", transport="twwin")',
    'Robot("so101", mode="real", transport="twin").misspelt()',
    'Robot("so101", mode="real", transport="twin").render()',
    'Robot("so101", mode="real", fri_port=30200)',
    'Robot("so101", port="/dev/ttyACM0")',
    'Robot("so101", backend="unity")',
    'Robot("kuka_iiwa", "real", fri_port="x")',
    'Robot("ur5e", "real", control_frequncy=100)',
    'Robot("unitree_g1", mode="real", on_exit="fall")',
    'Robot("crazyflie", mode="real", transport="twin").takeoff(hieght=1)',
    'Robot("spot").stand()',
    'open_robot("ur5e", mode="real", setpoint_hz=20)',
)

RIGHT = """
from pathlib import Path
from typing import Any, assert_type

from strands_actors import AsyncRobot, RealRobot, SimRobot

sim = Robot("so101")
simulated: SimRobot = sim
sim.set_torque(True)
real: RealRobot = Robot("so101", mode="real", transport="twin", sim=sim)
arm = Robot("so_arm101", mode="real", port=Path("/dev/ttyACM0"), baud_rate=1_000_000, calibration=Path("x"))
arm.stop()["status"]
Robot("cf2", "real", port="radio://0/80/2M", setpoint_hz=20).takeoff(0.5)
with Robot("crazyflie", mode="real", transport="twin") as drone:
    drone.land()
for name in ("so101", "ur5e"):
    assert_type(Robot(name, mode="real", port="x"), RealRobot)
    assert_type(Robot(name), SimRobot)
options: dict[str, Any] = {"gain": 3}
Robot("mine", mode="real", port="x", **options)
Robot("so101", mode="real", port="x", driver="lerobot", use_degrees=True)
Robot("omx", mode="real", port="x", max_relative_target=3)
Robot("so101", mode="auto")


async def main() -> None:
    async with open_robot("spot", mode="real", transport="twin") as spot:
        await spot.set_twist(0.3)
    async with open_robot("so101") as simulated:
        await simulated.step(steps=100, action={"elbow_flex": 1.0})
        robot: AsyncRobot = simulated
"""


def mypy(*files: Path) -> list[str]:
    """Return the errors that mypy finds, with the cache of the run over this package."""
    command = [sys.executable, "-m", "mypy", *map(str, files)]
    done = subprocess.run(command, cwd=ROOT, env=unmeasured(), capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    return [line for line in done.stdout.splitlines() if ": error: " in line]


def test_the_signatures_are_those_of_the_drivers() -> None:
    assert signatures.FILE.read_text() == signatures.text(), "run python -m tests.editors.signatures"


def test_mypy_refuses_each_mistake_and_nothing_that_is_right(tmp_path: Path) -> None:
    wrong, right = tmp_path / "wrong.py", tmp_path / "right.py"
    wrong.write_text("\n".join([BEGIN, *MISTAKES, ""]))
    right.write_text(f"{BEGIN}\n{RIGHT}")
    errors = mypy(wrong, right)
    assert [error for error in errors if "wrong.py" not in error] == []
    lines = {int(found[1]) for error in errors if (found := re.search(r"wrong\.py:(\d+)", error))}
    assert [each for line, each in enumerate(MISTAKES, 2) if line not in lines] == []


def test_mypy_accepts_the_calls_of_pages_and_examples(tmp_path: Path) -> None:
    files = sorted((ROOT / "examples").glob("*.py"))
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    blocks = [block for page in pages for block in BLOCK.findall(page.read_text()) if "import Robot" in block]
    assert len(blocks) > 10
    for number, block in enumerate(blocks):
        files.append(tmp_path / f"page_{number}.py")
        files[-1].write_text(block)
    strange = [
        error for error in mypy(*files) if re.search(r"\[(call-overload|attr-defined|call-arg|arg-type)\]", error)
    ]
    assert strange == []


@pytest.mark.parametrize(
    ("source", "offered"),
    [
        ('Robot("so101", mode="real", ', ("port=", "transport=", "baud_rate=", "motor_ids=", "require_drill=")),
        ('Robot("so101", ', ("mode=", "urdf_path=", "keyframe=", "backend=")),
        ('open_robot("ur5e", "real", rt', ("rtde_frequency=",)),
        ('Robot("so101", mode="real", transport="twin").', ("send_action", "stop", "get_observation")),
        ('Robot("crazyflie", mode="real", transport="twin").takeoff(', ("height=", "duration=")),
    ],
)
def test_jedi_offers_keywords_and_verbs(source: str, offered: tuple[str, ...]) -> None:
    script = jedi.Script(f"{BEGIN}\n{source}", project=jedi.Project(ROOT))
    names = {one.name for one in script.complete()}
    assert [name for name in offered if name not in names] == []

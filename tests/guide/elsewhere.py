"""How the Python blocks of the pages outside ``docs/guide`` run, or why they do not."""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from tests.cli.command import ROOT

from .blocks import blocks_of


class How(enum.Enum):
    """How the blocks of a page run."""

    AS_WRITTEN = enum.auto()  # in order, and what they print is compared with the page
    ON_TWINS = enum.auto()  # in order, with the twin of each robot in place of the real one
    AS_SCRIPT = enum.auto()  # each as a file, because other processes import its classes


class Blocks(NamedTuple):
    """The blocks of one page that run, and the reasons of those that do not."""

    how: How
    not_run: Mapping[int, str] = {}
    """The reason by the number of a block, from 1."""


PAGES: Mapping[str, Blocks] = {
    "README.md": Blocks(How.ON_TWINS),  # its comments explain the output
    "docs/calibration.md": Blocks(How.ON_TWINS),
    "docs/cameras.md": Blocks(
        How.AS_WRITTEN,
        {1: "needs a camera at /dev/video0", 2: "needs a running robot with a camera"},
    ),
    "docs/console.md": Blocks(How.AS_WRITTEN),
    "docs/datasets.md": Blocks(How.ON_TWINS),  # a busy machine may mark missing frames
    "docs/host.md": Blocks(How.ON_TWINS, {1: "needs a running host, as tests/host/test_host.py starts one"}),
    "docs/lerobot.md": Blocks(How.ON_TWINS, {1: "needs LeRobot, with which tests/lerobot runs its robots"}),
    "docs/lowering.md": Blocks(How.ON_TWINS),
    "docs/mesh.md": Blocks(How.ON_TWINS, {1: "needs the keys of a mesh, and stops every robot of it"}),
    "docs/motion.md": Blocks(How.ON_TWINS),
    "docs/own-drivers.md": Blocks(How.AS_SCRIPT),
    "docs/parts.md": Blocks(
        How.ON_TWINS,
        {
            1: "needs two ports; tests/parts/test_whole.py does it on two simulated arms",
            2: "needs the ports of an arm and a hand",
            3: "needs four ports; tests/parts/test_whole.py does it on simulated arms and leaders",
        },
    ),
    "docs/policies.md": Blocks(How.AS_WRITTEN),
    "docs/python.md": Blocks(How.AS_WRITTEN, {4: "a part of a trio program, which does not end"}),
    "docs/recording.md": Blocks(How.AS_WRITTEN, {1: "needs the recording that the command above it makes"}),
    "docs/ros2.md": Blocks(How.AS_WRITTEN, {1: "needs a node, as tests/ros2/test_foreign.py has one"}),
    "docs/safety-evidence.md": Blocks(How.ON_TWINS),
    "docs/teleoperation.md": Blocks(How.AS_WRITTEN, {1: "leads an arm until it is interrupted"}),
    "docs/testing.md": Blocks(
        How.AS_WRITTEN,
        {
            1: "tests a driver of the reader's package, as tests/screen/test_conformance.py does with blinky.py",
            3: "is a test with the fixture that tests/screen/test_plugin.py uses",
        },
    ),
    "docs/versioning.md": Blocks(How.AS_WRITTEN, {1: "a part of a function that is deprecated"}),
    "docs/robots/booster.md": Blocks(How.ON_TWINS),
    "docs/robots/can_motors.md": Blocks(How.ON_TWINS),
    "docs/robots/crazyflie.md": Blocks(How.ON_TWINS),
    "docs/robots/earthrover.md": Blocks(How.ON_TWINS, {2: "needs the robot's own program at port 8000"}),
    "docs/robots/franka.md": Blocks(How.ON_TWINS),
    "docs/robots/kinova.md": Blocks(How.ON_TWINS),
    "docs/robots/kuka.md": Blocks(How.ON_TWINS),
    "docs/robots/microduck.md": Blocks(How.ON_TWINS),
    "docs/robots/rby1.md": Blocks(How.ON_TWINS),
    "docs/robots/reachy.md": Blocks(How.ON_TWINS),
    "docs/robots/spot.md": Blocks(How.ON_TWINS),
    "docs/robots/stretch.md": Blocks(How.ON_TWINS),
    "docs/robots/unitree.md": Blocks(How.ON_TWINS),
    "docs/robots/ur.md": Blocks(How.AS_WRITTEN),
    "docs/robots/xarm.md": Blocks(How.ON_TWINS),
    "docs/robots/yahboom.md": Blocks(How.ON_TWINS),
}
MODEL = """\
<mujoco>
  <worldbody>
    <light pos="0 0 2"/>
    <body name="upper" pos="0 0 0.1">
      <joint name="elbow" type="hinge" axis="0 1 0" range="-1 1" damping="1"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0.2 0 0"/>
    </body>
  </worldbody>
  <actuator><position name="elbow" joint="elbow" kp="20" ctrlrange="-1 1"/></actuator>
  <keyframe><key name="home" qpos="0"/></keyframe>
</mujoco>
"""
"""The file ``my_arm.xml`` of docs/python.md."""


def pages_with_python() -> Iterator[str]:
    """Yield the pages outside ``docs/guide`` that have Python blocks."""
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")):
        name = page.relative_to(ROOT).as_posix()
        if not name.startswith("docs/guide/") and any(block.language == "python" for block in blocks_of(page)):
            yield name


def python_blocks(page: Path) -> list[str]:
    return [block.source for block in blocks_of(page) if block.language == "python"]


def to_run(name: str) -> list[int]:
    """Return the numbers of the blocks of a page that run, from 1."""
    count = len(python_blocks(ROOT / name))
    return [number for number in range(1, count + 1) if number not in PAGES[name].not_run]

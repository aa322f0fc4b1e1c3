"""Recordings of simulations begin with their robot, and are replayed like any other."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from strands_actors import RecordingError, Robot, record, record_dataset, replay
from strands_actors.caller.handle.real_robot import RealRobot
from strands_actors.drivers import SIMULATION
from strands_actors.surfaces.recording.code import driver_class_of
from tests.answers import json_of, until

SLIDE = """<mujoco><worldbody><body><joint name="slide" type="slide" axis="1 0 0" range="-1 1" limited="true"/>
<geom size=".1" mass="1"/></body></worldbody>
<actuator><position joint="slide" kp="50" kv="10"/></actuator></mujoco>"""


@pytest.mark.parametrize(("own", "axis", "target"), [(False, "shoulder_pan", 5.0), (True, "slide", 0.1)])
def test_a_simulation_is_recorded_from_before_its_first_command_and_replayed(
    own: bool, axis: str, target: float, tmp_path: Path
) -> None:
    model = tmp_path / "slide.xml"
    model.write_text(SLIDE)
    path = tmp_path / "run.mcap"
    with Robot("so101", **({"urdf_path": str(model)} if own else {})) as arm, record(arm, path):
        json_of(arm.send_action({axis: target}))
        until(lambda: abs(arm.get_observation()[axis] - target) < 0.2 * target, "it moves")
        time.sleep(0.2)
    assert replay(path).equal


def record_file(arm: RealRobot, folder: Path) -> None:
    with record(arm, folder / "run.mcap"):
        raise AssertionError("nothing is recorded")


def record_episodes(arm: RealRobot, folder: Path) -> None:
    record_dataset(arm, folder / "data", task="pick")


@pytest.mark.parametrize("begin", [record_file, record_episodes])
def test_a_robot_that_cannot_connect_is_not_recorded_and_gives_the_reason(
    begin: Callable[[RealRobot, Path], None], tmp_path: Path
) -> None:
    arm = Robot("so101", mode="real", port=str(tmp_path / "no-port"))
    try:
        with pytest.raises(RecordingError, match=r"connect: .*no-port"):
            begin(arm, tmp_path)
    finally:
        arm.cleanup()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("named", ["os:system", SIMULATION, None, 5])
def test_a_file_names_no_code_to_run_by_calling_it_simulated(named: object) -> None:
    with pytest.raises(RecordingError, match="so101 was recorded with the driver"):
        driver_class_of({"robot": "so101", "class": SIMULATION, "options": {"class": named}})

"""An episode of a dataset replays its recorded actions on a robot, or is refused by name."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from strands_actors import record_dataset, replay_episode
from strands_actors.contract.driver import Driver
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.surfaces import cli
from strands_actors.surfaces.dataset import DatasetError
from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.played import Played, read_episode, rows_for
from strands_actors.testing import Twin
from tests.answers import json_of
from tests.cli.command import Command
from tests.robot.helpers import IDS, goals

from .made import LAYOUT, begin, fill, row

DEGREES = ("deg", "deg", "percent")


def made(root: Path, units: tuple[str, ...] = DEGREES) -> Path:
    """Return a dataset with two episodes."""
    dataset = Dataset(root)
    for frames in (20, 10):
        episode = begin(dataset, layout=msgspec.structs.replace(LAYOUT, units=units))
        fill(episode, [row(number) for number in range(frames)])
        episode.finish()
        dataset.commit(episode.folder)
    dataset.close()
    return root


def an_arm() -> Driver:
    return Feetech("so101", "", Feetech.resolve("so101", {}))


def test_an_episode_is_read_as_it_was_recorded(tmp_path: Path) -> None:
    played = read_episode(made(tmp_path / "set"), 1)
    assert played.joints == ("shoulder_pan", "elbow_flex", "gripper") and played.units == DEGREES
    assert played.hz == 30.0 and len(played.rows) == 10 and played.task == "put the cube down"
    assert played.rows[3] == pytest.approx(row(3).action, rel=1e-6)
    rows = rows_for(an_arm(), played)
    assert rows[3] == dict(zip(played.joints, played.rows[3], strict=True))


@pytest.mark.parametrize(
    ("episode", "says"), [(2, "no episode 2 (there are 0 to 1)"), (-1, "no episode -1"), ("0", "no episode '0'")]
)
def test_a_missing_episode_is_refused(tmp_path: Path, episode: Any, says: str) -> None:
    with pytest.raises(DatasetError) as refused:
        read_episode(made(tmp_path / "set"), episode)
    assert says in str(refused.value)


def test_a_missing_dataset_and_a_damaged_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="is not a dataset"):
        read_episode(tmp_path / "nothing", 0)
    data = min(made(tmp_path / "set").glob("data/*/*.parquet"))
    table = pq.read_table(data)
    pq.write_table(table.slice(1), data)
    with pytest.raises(DatasetError, match="episode 0 is damaged"):
        read_episode(tmp_path / "set", 0)
    data.write_bytes(data.read_bytes()[:100])
    with pytest.raises(DatasetError, match="cannot be read"):
        read_episode(tmp_path / "set", 0)


def test_frames_out_of_order_are_damage(tmp_path: Path) -> None:
    data = min(made(tmp_path / "set").glob("data/*/*.parquet"))
    table = pq.read_table(data)
    order = np.arange(table.num_rows)
    order[[3, 4]] = 4, 3
    pq.write_table(table.take(pa.array(order)), data)
    with pytest.raises(DatasetError, match="episode 0 is damaged"):
        read_episode(tmp_path / "set", 0)


def played(units: tuple[str, ...] = (), joints: tuple[str, ...] = ("shoulder_pan", "gripper")) -> Played:
    return Played(joints, units, ((50.0, 25.0), (-100.0, 0.0)), 30.0, "")


@pytest.mark.parametrize(
    ("given", "units", "says"),
    [
        (played(), "", "Give units='degrees' or 'normalized'"),
        (played(), "radians", "Give units='degrees' or 'normalized'"),
        (played(), "normalized", "Give the robot calibration="),
        (played(("rad", "percent")), "", "shoulder_pan was recorded in rad, but so101 uses deg"),
        (
            played(("deg", "percent")),
            "normalized",
            "units is 'normalized', but the dataset has deg, percent",
        ),
        (played(joints=("joint1", "gripper")), "degrees", "so101 has no joint joint1"),
    ],
)
def test_numbers_with_an_unknown_or_another_unit_move_nothing(given: Played, units: str, says: str) -> None:
    with pytest.raises(DatasetError) as refused:
        rows_for(an_arm(), given, units)
    assert says in str(refused.value)


def test_lerobots_own_numbers_are_shares_of_the_calibrated_range(monkeypatch: pytest.MonkeyPatch) -> None:
    driver = an_arm()
    monkeypatch.setattr(driver, "travel", lambda: {"shoulder_pan": (-80.0, 120.0), "gripper": (0.0, 100.0)})
    assert rows_for(driver, played(), "normalized") == [
        {"shoulder_pan": 70.0, "gripper": 25.0},
        {"shoulder_pan": -80.0, "gripper": 0.0},
    ]
    assert rows_for(driver, played(), "degrees")[0] == {"shoulder_pan": 50.0, "gripper": 25.0}


def test_an_arm_repeats_its_recorded_motion(arm: Any, twin: Twin, tmp_path: Path) -> None:
    arm.connect_eagerly()
    with record_dataset(arm, tmp_path / "set", task="wave") as recording, recording.episode():
        json_of(arm.move_to({"shoulder_pan": 20.0}, seconds=1.0))
        json_of(arm.move_to({"shoulder_pan": -20.0}, seconds=1.0))
    json_of(arm.move_to({"shoulder_pan": 0.0, "elbow_flex": 10.0}, seconds=1.0))
    began_ns = time.monotonic_ns()
    result = json_of(replay_episode(arm, tmp_path / "set"))
    assert result["rows"] == recording.saved[0]["frames"]
    assert result["position"]["shoulder_pan"] == pytest.approx(-20.0, abs=3.0)
    path = [goals(entry)[IDS["shoulder_pan"]] for entry in twin.log.host("setpoint", began_ns)]
    assert 0 < path.index(max(path)) < len(path) - 1, "the arm moved to one side and back"


def test_the_command_plays_it_on_a_robot_that_runs(arm: Any, twin: Twin, tmp_path: Path) -> None:
    arm.connect_eagerly()
    arm.release()
    root, strange = made(tmp_path / "set"), made(tmp_path / "strange", units=())
    command = Command(Path(os.environ["STRANDS_ACTORS_RUN"]))
    done = command.run("dataset", "play", str(root), arm.name, "--episode", "1", "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["played"] and result["rows"] == 10
    done = command.run("dataset", "play", str(strange), arm.name)
    assert done.returncode == cli.USAGE and "Give units='degrees' or 'normalized'" in done.stderr
    done = command.run("dataset", "play", str(strange), arm.name, "--units", "degrees")
    assert done.returncode == 0 and "20 frames at 30 fps: put the cube down" in done.stdout, done.stderr
    arm.stop()
    done = command.run("dataset", "play", str(root), arm.name)
    assert done.returncode == 1 and "resume" in done.stderr, done.stderr
    done = command.run("dataset", "play", str(root), arm.name, "--resume")
    assert done.returncode == 0, done.stderr


def test_a_twin_plays_an_episode_without_a_running_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = made(tmp_path / "set")
    assert cli.run(("dataset", "play", str(root), "--twin", "--episode", "1", "--json")) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["robot"] == "so101" and said["played"] and said["rows"] == 10
    for arguments, says in (
        ((), "give the name of a running robot, or --twin"),
        (("--twin", "--resume"), "Leave --resume and --mesh out"),
        (("koch", "--twin", "--episode", "7"), "no episode 7"),
        (("nothing", "--twin"), "nothing"),
        (("ur5e", "--twin"), "ur5e has no joint shoulder_pan"),
    ):
        assert cli.run(("dataset", "play", str(root), *arguments)) == cli.USAGE
        output = capsys.readouterr().err
        assert says in output and output.count("\n") == 1, output

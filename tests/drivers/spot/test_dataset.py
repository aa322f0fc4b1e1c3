"""Test that a robot without an arm is recorded with the axes that it has, and with its legs in the state."""

from __future__ import annotations

import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from strands_actors import record_dataset
from strands_actors.drivers.spot.robots import KEYS, LEGS, TABLES
from strands_actors.testing import Twin
from tests.answers import json_of
from tests.dataset.made import check, info_of
from tests.trees import armed, robot_on


@pytest.mark.parametrize(("arm", "count"), [(False, 3), (True, len(KEYS))])
def test_a_dataset_has_the_axes_that_the_robot_has(arm: bool, count: int, tmp_path: Path, run_dir: Path) -> None:
    root = tmp_path / "set"
    with Twin("spot", tmp_path, options={"arm": arm, "haste": 5.0}) as twin, robot_on(twin.port, "spot") as spot:
        armed(spot)
        json_of(spot.stand())
        with record_dataset(spot, root, task="walk") as recording, recording.episode():
            ends = time.monotonic() + 1.5
            while time.monotonic() < ends:
                json_of(spot.send_action({"vx": 0.1}))
                time.sleep(0.05)
    features = info_of(root)["features"]
    names = [f"{key}.{'vel' if key in KEYS[:3] else 'pos'}" for key in KEYS[:count]]
    legs = [f"{key}.pos" for key in LEGS]
    assert features["action"]["names"] == names and features["observation.state"]["names"] == names + legs
    units = ["m/s", "m/s", "rad/s", *["rad"] * (count - 3)]
    assert features["action"]["units"] == units
    assert features["observation.state"]["units"] == units + ["rad"] * len(legs)
    table = pq.read_table(root / "data/chunk-000/file-000.parquet").to_pylist()
    assert len(table) > 10 and {len(row["action"]) for row in table} == {count}
    assert max(row["action"][0] for row in table) == pytest.approx(0.1)
    assert check(root) == 1
    standing = list(TABLES.table("spot")["stand_leg_rad"]) * 4
    assert table[-1]["observation.state"][count:] == pytest.approx(standing, abs=1e-3)

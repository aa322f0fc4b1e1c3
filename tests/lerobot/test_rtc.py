"""``lerobot_local`` with ``rtc=True`` and a policy of LeRobot's that does it: the rest of a chunk is
what the next one begins with."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from strands_actors.policies.lerobot import LerobotLocal
from tests.answers import json_of, until

from .calibration import MOTORS
from .small_vla import save
from .test_dataset import CAMERA, at_its_rate, looking

PICTURE = (3, CAMERA["front"]["height"], CAMERA["front"]["width"])
CHUNK, HORIZON, LEFT = 30, 10, 4
ABOUT = dict.fromkeys(MOTORS, 0.0) | {"gripper": 10.0}
"""Where the twin is when it begins; a gripper knows no less than 0 percent, and the gate refuses that."""
STATE = {axis: at + 0.5 for axis, at in ABOUT.items()}
HZ = 5
"""The ten actions of a chunk last two seconds then. An inference takes a good part of one, and one
that is late ends the rollout, as it has to."""


def test_what_is_still_to_be_executed_is_what_the_next_chunk_begins_with_and_it_drives_the_twin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    checkpoint = save(tmp_path / "vla", PICTURE, list(ABOUT.values()), CHUNK)
    with looking() as arm:
        until(lambda: json_of(arm.get_status())["cameras"]["front"]["state"] == "streaming", "it sees")
        _blends(checkpoint, arm.name)
    asked = {"pretrained_name_or_path": str(checkpoint), "rtc": True, "execution_horizon": HORIZON}
    at_its_rate(asked, HZ)


def _blends(checkpoint: Path, robot: str) -> None:
    import torch

    policy = LerobotLocal(
        MOTORS, str(checkpoint), "degrees", unit="degrees", robot=robot, cameras=("front",), rtc=True,
        execution_horizon=HORIZON,
    )  # fmt: skip
    policy.reset()
    assert len(policy.get_actions_sync(STATE, "swing")) == HORIZON
    expected = policy._rest[HORIZON : HORIZON + LEFT]  # what would have been executed after these
    distances = {}
    for rest in (policy._rest, None):
        policy._rest, policy._handed_out = rest, HORIZON
        policy.actions_left(LEFT)
        torch.manual_seed(1)
        actions = policy.get_actions_sync(STATE, "swing")
        distances[rest is None] = _distance(actions, expected.tolist())
    assert distances[False] < 0.7 * distances[True], distances


def _distance(actions: list[dict[str, float]], rows: list[list[float]]) -> float:
    return sum(_apart(action, row) for action, row in zip(actions, rows, strict=False))


def _apart(action: Mapping[str, float], row: list[float]) -> float:
    return sum(abs(value - other) for value, other in zip(action.values(), row, strict=True))

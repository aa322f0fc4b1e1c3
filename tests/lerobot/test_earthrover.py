"""LeRobot's own EarthRoverMiniPlus, unmodified, against our twin."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from lerobot.robots.earthrover_mini_plus import EarthRoverMiniPlus, EarthRoverMiniPlusConfig

from strands_actors.drivers.earthrover import protocol as p
from strands_actors.testing import Twin
from tests.answers import until


def test_it_connects_sees_and_drives_the_twin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_PROXY", "*")
    with Twin("earthrover", tmp_path) as twin:
        rover = EarthRoverMiniPlus(EarthRoverMiniPlusConfig(id="black", calibration_dir=tmp_path))
        rover.sdk_base_url = f"http://{twin.port}"  # it has no use for its configuration's
        rover.connect()
        assert rover.is_connected
        keys = {name: next(key for key in rover.action_features if name in key) for name in ("linear", "angular")}

        def drive(linear: float, angular: float = 0.0) -> None:
            rover.send_action({keys["linear"]: linear, keys["angular"]: angular})

        seen = rover.get_observation()
        assert set(seen) == set(rover.observation_features)
        pictures = {name: seen[name] for name in p.PICTURES}
        assert all(picture.shape == (480, 640, 3) and picture.any() for picture in pictures.values())
        assert one(seen, "battery") in (88.0, 0.88)  # 0.4.4 divides by full scale
        drive(0.5)
        until(lambda: one(rover.get_observation(), "speed", "linear") > 0, "it drives")
        drive(0.5, 0.5)
        heading = one(rover.get_observation(), "orientation")
        until(lambda: one(rover.get_observation(), "orientation") != heading, "it turns")
        drive(0.0)
        until(lambda: one(rover.get_observation(), "speed", "linear") == 0, "it stands")
        drive(0.4)
        rover.disconnect()
        frames = [entry.data for entry in twin.log.entries() if entry.sender == "host"]
        sent = [frame for frame in frames if p.CONTROL.encode() in frame]
        assert len(sent) == 5 and b"0.5" in sent[0] and b"0.4" in sent[3] and b"0.0" in sent[4]


def one(seen: Mapping[str, Any], *words: str) -> float:
    """The value whose key has one of these words in it."""
    return next(float(value) for key, value in seen.items() if any(word in key for word in words))

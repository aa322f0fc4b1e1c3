"""LeRobot's calibration file of a twin, which stands as its servos left the factory."""

from __future__ import annotations

import json
from pathlib import Path

MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
NAME = "black"


def write(folder: Path, name: str = NAME) -> None:
    """For any arm of six servos."""
    motors = {
        motor: {"id": at, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}
        for at, motor in enumerate(MOTORS, start=1)
    }
    (folder / f"{name}.json").write_text(json.dumps(motors))

"""``lerobot-calibrate`` and our sweep agree on twins that were built with a fault, and ours names the fault."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from lerobot.motors import motors_bus
from lerobot.motors.feetech import FeetechMotorsBus
from lerobot.scripts import lerobot_calibrate

from strands_actors.drivers.common.servo.findings import Kind
from strands_actors.testing import Twin
from tests.calibration.hands import ENDS, JOINTS, Hands, calibrate_as_built_first, plan_of, sweep

A_DEGREE = 4096 / 360
TURN = 4096
STILL, STARTS = 10, 100
WHOLE_TURN = "wrist_roll"
DIFFERENT_FIRMWARE = "Some Motors use different firmware versions"


class Built(NamedTuple):
    """A twin: its assembly, the range of its joints, the answer of our sweep, and how it is then accepted."""

    assembly: str
    range_rad: tuple[float, float] = ENDS
    refused: str = ""
    accepted: tuple[str, ...] = ()
    finding: Kind | None = None
    theirs: bool = True


FAULTS = {
    "too little": Built("1:id=1", (0.0, 0.8), "shoulder_pan was swept over", JOINTS),
    "swapped": Built("1:id=2,2:id=1", refused="the servo of shoulder_lift moved"),
    "horn": Built("3:turned=14.4", finding=Kind.SHIFTED),
    "ratio": Built("1:ratio=1.5", refused="another gear ratio", accepted=("shoulder_pan",)),
    "firmware": Built("3:firmware=3.9", refused="has firmware 3.9", accepted=("firmware",), theirs=False),
    "wrap": Built("1:turned=170", finding=Kind.WRAPS),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_our_sweep_agrees_with_lerobot_calibrate_within_a_degree_and_names_the_fault(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = FAULTS[fault]
    with Twin("so101", tmp_path, by_hand=True, options={"assembly": built.assembly}) as twin:
        if fault == "horn":
            calibrate_as_built_first(twin)
        if built.refused:
            with pytest.raises(ValueError, match=built.refused):
                sweep("so101", twin, Hands(twin), plan_of("so101", built.range_rad))
        ours: Mapping[str, Any] = {}
        if not built.refused or built.accepted:
            plan = plan_of("so101", built.range_rad, built.accepted)
            proposal = sweep("so101", twin, Hands(twin), plan)
            assert [finding.kind for finding in proposal.findings] == ([built.finding] if built.finding else [])
            ours = {key: _ends(vars_of(motor), key) for key, motor in proposal.motors.items()}
        written = _lerobot_calibrate(twin, tmp_path, monkeypatch)
        if not built.theirs:
            assert DIFFERENT_FIRMWARE in written
            return
        theirs = {key: _ends(motor, key) for key, motor in json.loads(written).items()}
        for key, ends in ours.items():
            for one, other in zip(ends, theirs[key], strict=True):
                apart = (one - other + TURN // 2) % TURN - TURN // 2
                assert abs(apart) <= A_DEGREE, (key, ends, theirs[key])


def vars_of(motor: Any) -> dict[str, int]:
    return {field: getattr(motor, field) for field in motor.__struct_fields__}


def _ends(motor: Mapping[str, int], key: str) -> tuple[int, ...]:
    """Return the encoder's counts at both ends, or in the middle of a joint that turns without an end."""
    middle = (TURN - 1) // 2
    counts = (middle,) if key == WHOLE_TURN else (motor["range_min"], motor["range_max"])
    return tuple(count + motor["homing_offset"] for count in counts)


class TheirPerson:
    """Does by hand what ``lerobot-calibrate`` asks for: the middle first, then both ends."""

    def __init__(self, twin: Twin) -> None:
        self._twin = twin
        self._moves = [{joint: angle} for joint in JOINTS for angle in ENDS]
        self.bus: Any = None

    def connected(self, bus: Any) -> None:
        self.bus = bus

    def press(self, prompt: str = "") -> str:
        """Replace ``input``."""
        self._move(dict.fromkeys(JOINTS, sum(ENDS) / 2))
        return ""

    def has_pressed(self) -> bool:
        """Replace LeRobot's ``enter_pressed``, which it calls after each reading."""
        if not self._moves:
            return True
        self._move(self._moves.pop(0))
        return False

    def _move(self, angles: Mapping[str, float]) -> None:
        self._twin.move_by_hand(**angles)
        recent: list[dict[str, int]] = []
        while len(recent) < STILL + 2 or any(
            max(row[key] for row in recent[-STILL:]) - min(row[key] for row in recent[-STILL:]) > 0
            for key in JOINTS
        ):
            recent.append(self.bus.sync_read("Present_Position", normalize=False, num_retry=5))
            time.sleep(0.02)


def _lerobot_calibrate(twin: Twin, home: Path, patch: pytest.MonkeyPatch) -> str:
    """Run LeRobot's command in this process, and carry out its instructions. Return its file, or its error.

    Its client requests an answer once. On a busy machine it is started again."""
    file = home / "theirs.json"
    arguments = ("--robot.type=so101_follower", f"--robot.port={twin.port}", "--robot.id=theirs")
    patch.setattr(sys, "argv", ["lerobot-calibrate", *arguments, f"--robot.calibration_dir={home}"])
    connect = FeetechMotorsBus.connect
    error = ""
    for _ in range(STARTS):
        file.unlink(missing_ok=True)
        person = TheirPerson(twin)

        def connected(bus: Any, *args: Any, person: TheirPerson = person, **keywords: Any) -> None:
            person.connected(bus)
            connect(bus, *args, **keywords)

        patch.setattr(FeetechMotorsBus, "connect", connected)
        patch.setattr("builtins.input", person.press)
        patch.setattr(motors_bus, "enter_pressed", person.has_pressed)
        try:
            lerobot_calibrate.main()
        except (ConnectionError, RuntimeError) as failure:
            error = str(failure)
            if DIFFERENT_FIRMWARE in error:
                return error
            with contextlib.suppress(ConnectionError, RuntimeError):
                person.bus.disconnect(disable_torque=False)
        if file.exists():
            return file.read_text()
    raise AssertionError(error)

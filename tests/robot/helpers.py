"""Read the wire log of an SO-101 twin in tests."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from strands_actors.drivers.feetech import protocol as p
from strands_actors.testing import Entry, WireLog
from tests.answers import json_of, until

IDS = {"shoulder_pan": 1, "shoulder_lift": 2, "elbow_flex": 3, "wrist_flex": 4, "wrist_roll": 5, "gripper": 6}
COUNTS_PER_DEGREE = 4095 / 360

FEEDBACK = (8, 24)
"""Sizes in bytes of the two blocks that are read in turn. Both contain the position."""
FEEDBACK_END = p.TEMPERATURE.address + 1


def far(arm: Any, joint: str = "shoulder_pan") -> float:
    """Return a position of the joint on the other side of its middle."""
    return -40.0 if arm.get_observation()[joint] > 0 else 40.0


def moves(arm: Any, joint: str = "shoulder_pan") -> None:
    """Send the joint far away, and wait until it has moved by more than 5 degrees."""
    before = arm.get_observation()[joint]
    json_of(arm.send_action({joint: far(arm, joint)}))
    until(lambda: abs(arm.get_observation()[joint] - before) > 5.0, "the joint moves")


def at(arm: Any, joint: str, value: float, within: float = 2.0) -> None:
    until(lambda: abs(arm.get_observation()[joint] - value) < within, f"{joint} is at {value}")


def measured_before(log: WireLog, t_ns: int) -> dict[int, int]:
    """Return the last position that each servo reported before ``t_ns``, in counts."""
    positions: dict[int, int] = {}
    for entry in log.entries():
        frame = packet(entry)
        if entry.t_ns < t_ns and entry.sender == "robot" and frame is not None and len(frame.params) in FEEDBACK:
            positions[frame.id] = p.POSITION.decode(frame.params, FEEDBACK_END - len(frame.params))
    return positions


def packet(entry: Entry) -> p.Packet | None:
    return next(iter(p.Decoder().feed(entry.data)), None)


def goals(entry: Entry) -> dict[int, int]:
    """Return the goal of each servo in a setpoint or a hold, in counts."""
    frame = packet(entry)
    assert frame is not None
    assert frame.params[0] == p.GOAL_POSITION.address
    step, rows = frame.params[1] + 1, frame.params[2:]
    return {rows[i]: p.GOAL_POSITION.decode(rows[i + 1 : i + 3]) for i in range(0, len(rows), step)}


def limps(log: WireLog, since_ns: int = 0) -> list[Entry]:
    """Return the frames that release every servo."""
    return [entry for entry in log.host("safe", since_ns) if entry.data == p.LIMP]


def holds(log: WireLog, since_ns: int = 0) -> list[Entry]:
    return [entry for entry in log.host("safe", since_ns) if entry.data != p.LIMP]


def armed_at(log: WireLog, since_ns: int = 0) -> dict[int, int]:
    """Return the goal with which each servo was armed.

    Check that a separate frame wrote this goal before torque was switched on, and that it equals the
    position which was measured just before.
    """
    armed: dict[int, int] = {}
    for entry in log.entries(since_ns):
        if entry.sender == "host" and entry.kind == "enable":
            frame = packet(entry)
            assert frame is not None and frame.id in armed, "torque without a goal before it"
        elif entry.sender == "host" and entry.kind == "safe" and entry.data != p.LIMP and not entry.safe_state:
            assert goals(entry).items() <= measured_before(log, entry.t_ns).items()
            armed |= goals(entry)
    return armed


def register_now(log: WireLog, register: p.Register, since_ns: int = 0) -> dict[int, int]:
    """Return the last value of a register that each servo reported on the wire. A late reply may be
    counted for the wrong request."""
    first_address, size, values = 0, 0, {}
    for entry in log.entries(since_ns):
        frame = packet(entry)
        if frame is None:
            continue
        if entry.sender == "host":
            if frame.code in (p.READ, p.SYNC_READ):
                first_address, size = frame.params[:2]
        elif size == len(frame.params) and first_address <= register.address < first_address + size:
            values[frame.id] = register.decode(frame.params, first_address)
    return values


def torque_now(log: WireLog, since_ns: int = 0) -> dict[int, int]:
    return register_now(log, p.TORQUE_ENABLE, since_ns)


def replies(log: WireLog, since_ns: int, until_ns: int) -> Counter[int]:
    """Count the replies of each servo."""
    return Counter(
        entry.data[2] for entry in log.entries(since_ns) if entry.sender == "robot" and entry.t_ns < until_ns
    )


def completed_run(arm: Any, policy: Any, **arguments: Any) -> dict[str, Any]:
    """Run a policy by ``run`` through its whole time, and return the report.

    On a machine that pauses, a setpoint may expire, and the run ends in a hold. So try three times.
    """
    for _ in range(3):
        answer = arm.run(policy, **arguments)
        if answer["status"] == "success":
            break
    report = json_of(answer)
    assert (report["exit_reason"], report["refused"], report["unconfirmed"]) == ("duration", 0, []), report
    assert report["steps"] >= 1 and report["running"] is False
    return report


class Ahead:
    """A policy that moves one joint by one degree in each step."""

    def __init__(self) -> None:
        self.steps = 0

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        self.steps += 1
        return {"elbow_flex": observation["elbow_flex"] + 1.0}

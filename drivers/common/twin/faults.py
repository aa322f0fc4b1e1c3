"""Faults of a simulated robot, with the names that PX4 uses, and the effect of each on the robot's replies.

``off``           no supply: the robot receives nothing, sends nothing, holds nothing
``stuck``         the robot repeats its last readings, and does not move
``garbage``       the bytes of its replies are damaged
``wrong``         its replies are well-formed, with wrong values
``slow``          replies come later, but within usual timeouts
``delayed``       replies come after any usual timeout, without delaying other frames
``intermittent``  every third reply is missing
``half-open``     the robot receives and obeys, but its replies are lost: one direction of the line is cut

``off``, ``stuck`` and ``wrong`` depend on the meaning of a reply, so each robot implements them itself.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

SLOW_S = 0.0025
DELAYED_S = 0.06
MISSING_EVERY = 3


class Fault(enum.StrEnum):
    OK = "ok"
    OFF = "off"
    STUCK = "stuck"
    GARBAGE = "garbage"
    WRONG = "wrong"
    SLOW = "slow"
    DELAYED = "delayed"
    INTERMITTENT = "intermittent"
    HALF_OPEN = "half-open"


def parse_fault(text: str) -> tuple[Fault, int | None]:
    """Parse ``WORD`` (the name of a fault), or ``WORD:number`` for a fault of one motor or part. For any other text
    raise ``ValueError``, which lists the names."""
    word, colon, unit = text.partition(":")
    try:
        return Fault(word), int(unit) if colon else None
    except ValueError:
        raise ValueError(
            f"fault {text!r} is not WORD or WORD:number (of a motor or part). "
            f"Use one of these words: {', '.join(Fault)}"
        ) from None


class Reply(NamedTuple):
    """One frame that the robot sends. ``delay_s`` also delays the frames after it; ``late_s`` does not."""

    delay_s: float
    data: bytes
    unit: int | None = None  # sender of the frame, such as a servo id; None if there is only one possible sender
    kind: str = "read"
    late_s: float = 0.0


class Faults:
    """The present faults of single units (such as servos), and the present fault of all other units."""

    def __init__(self) -> None:
        self._everyone = Fault.OK
        self._by_unit: dict[int, Fault] = {}
        self._replies: dict[int | None, int] = {}

    def set(self, fault: Fault, unit: int | None = None) -> None:
        """Set a fault of one unit. Without a unit it applies to all units, and replaces the faults of single
        units."""
        if unit is None:
            self._everyone = fault
            self._by_unit.clear()
        else:
            self._by_unit[unit] = fault
        self._replies.clear()

    def of(self, unit: int | None) -> Fault:
        return self._everyone if unit is None else self._by_unit.get(unit, self._everyone)

    def apply(self, reply: Reply) -> Reply | None:
        """Return the reply after the fault has changed or delayed it; None if it is lost. The result depends only
        on the fault and on the number of earlier replies."""
        fault = self.of(reply.unit)
        if fault is Fault.OK or fault is Fault.STUCK or fault is Fault.WRONG:
            return reply
        if fault is Fault.OFF or fault is Fault.HALF_OPEN:
            return None
        if fault is Fault.SLOW:
            return reply._replace(delay_s=reply.delay_s + SLOW_S)
        if fault is Fault.DELAYED:
            return reply._replace(late_s=reply.late_s + DELAYED_S)
        count = self._replies[reply.unit] = self._replies.get(reply.unit, 0) + 1
        if fault is Fault.INTERMITTENT:
            return None if count % MISSING_EVERY == 0 else reply
        return reply._replace(data=damaged(reply.data, count))


def damaged(data: bytes, count: int) -> bytes:
    """Return ``data`` with damage. ``count`` selects the kind of damage: a wrong last byte, noise, or a missing
    end."""
    match count % 3:
        case 0:
            return data[:-1] + bytes(byte ^ 0x55 for byte in data[-1:])
        case 1:
            return bytes(byte ^ 0xA5 for byte in data)
        case _:
            return data[:-1]

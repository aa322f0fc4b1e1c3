"""Faults of a robot, in PX4's words, and what each does to its replies.

``off``           no supply: hears nothing, says nothing, holds nothing
``stuck``         answers with the readings it had, and does not move
``garbage``       the bytes of its replies are damaged
``wrong``         well-formed replies with wrong values
``slow``          replies later, within sane timeouts
``delayed``       replies after any sane timeout, while the wire goes on
``intermittent``  every third reply is missing
``half-open``     hears and obeys, and nothing that it says arrives: one direction of the line is cut

``off``, ``stuck`` and ``wrong`` need to know what a reply means: the robot does them itself.
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
    """``WORD`` or ``WORD:unit``. Raise ``ValueError`` with the words there are."""
    word, colon, unit = text.partition(":")
    try:
        return Fault(word), int(unit) if colon else None
    except ValueError:
        raise ValueError(f"fault {text!r} is not WORD or WORD:unit. words: {', '.join(Fault)}") from None


class Reply(NamedTuple):
    """One frame from the robot. ``delay_s`` holds up what follows it on the wire, ``late_s`` does
    not."""

    delay_s: float
    data: bytes
    unit: int | None = None  # who says it: servo id, node; None on a wire with one speaker
    kind: str = "read"
    late_s: float = 0.0


class Faults:
    """Which unit has which fault."""

    def __init__(self) -> None:
        self._everyone = Fault.OK
        self._by_unit: dict[int, Fault] = {}
        self._replies: dict[int | None, int] = {}

    def set(self, fault: Fault, unit: int | None = None) -> None:
        """Without a unit the fault is everyone's, and replaces what single units had."""
        if unit is None:
            self._everyone = fault
            self._by_unit.clear()
        else:
            self._by_unit[unit] = fault
        self._replies.clear()

    def of(self, unit: int | None) -> Fault:
        return self._everyone if unit is None else self._by_unit.get(unit, self._everyone)

    def apply(self, reply: Reply) -> Reply | None:
        """Return what becomes of a reply; None: nothing is heard. The n-th reply always fares
        alike."""
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
    """Never equal to ``data``: by turns a last byte that is wrong, noise for the whole, and a lost
    end."""
    match count % 3:
        case 0:
            return data[:-1] + bytes(byte ^ 0x55 for byte in data[-1:])
        case 1:
            return bytes(byte ^ 0xA5 for byte in data)
        case _:
            return data[:-1]

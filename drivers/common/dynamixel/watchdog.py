"""The bus watchdog, register 98: what the firmware does when nobody speaks to it any more.

With torque on, a servo that has heard no instruction for that long stops where it is, torque still
on, sets the register to -1 and refuses goals until 0 is written. It is the third line: the wire
process itself stops within 50 ms, the root's stop channel within 150 ms; the firmware when both are
gone, or the cable.

*Any* instruction feeds it, a read too. So a reader that outlives what moves the arm would keep a
servo driving to its last goal for ever. Here both are earned. Reads are ordered by the watchdog
actor, which orders none when the gate or the transport does not answer. And after a setpoint the
wire reads for ``FEED_S`` only, unless another setpoint, its re-send or a safe frame follows, as
always one does when the chain is whole; nor does it read on when a servo answered a safe frame and
is still driven. It then reports what it last knew, whose age refuses every move, and the firmware
stops the arm. An arm that rests or holds may be read for ever.

A trip is reported as a fault and cleared by the next ``resume()`` only, with the torque off: what a servo does
with its old goal when it is cleared under torque is not documented.
"""

from __future__ import annotations

from .table import WATCHDOG_COUNT_S

COUNTS = 15
"""Longer than the longest pause of a healthy wire, 0.15 s: the quiet time after a lost reply and
one cycle. A machine that pauses for longer is stopped by it."""

SECONDS = COUNTS * WATCHDOG_COUNT_S

FEED_S = 0.5
"""A live setpoint is re-sent every 0.1 s."""

TRIPPED = "bus watchdog"
UNARMED = "bus watchdog off"
"""Words in ``faults``: of a servo that has stopped by itself, and of one that would not any more, since
another program has written the register."""

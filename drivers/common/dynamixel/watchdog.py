"""Values of the bus watchdog (register 98), which stops a servo when its bus is silent.

With torque on, a servo that has received no instruction for the set time stops where it is and
keeps its torque. It sets the register to -1, and refuses goals until 0 is written. This is the third
line of defence. The wire process stops the arm within 50 ms, the root's stop channel within 150 ms,
and the firmware when both are gone, or the cable.

*Any* instruction feeds it, a read too. So a process that only reads could keep a servo driving to
its last goal for ever. Two rules prevent that:

* The watchdog actor orders the reads, and orders no read when the gate or the transport does not
  answer.
* After a setpoint the wire reads for ``FEED_S`` only, unless another setpoint, a re-send or a safe
  frame follows. One always follows while all processes work. The wire also stops reading when a
  servo answered a safe frame and is still driven.

Without reads, the wire reports the last readings, whose age makes the gate refuse every move, and
the firmware stops the arm. An arm that rests or holds may be read for ever.

A trip is reported as a fault. Only the next ``resume()`` clears it, with the torque off, because it
is not documented how a servo treats its old goal when the trip is cleared under torque.
"""

from __future__ import annotations

from .table import WATCHDOG_COUNT_S

COUNTS = 15
"""Watchdog time in register counts. It is longer than the longest pause of a healthy wire, 0.15 s
(the quiet time after a lost reply, and one cycle). If the computer pauses for longer, the servos
stop."""

SECONDS = COUNTS * WATCHDOG_COUNT_S

FEED_S = 0.5
"""How long the wire reads after a setpoint. A live setpoint is re-sent every 0.1 s."""

TRIPPED = "bus watchdog"
UNARMED = "bus watchdog off"
"""Words in ``faults``. ``TRIPPED``: the servo has stopped by itself. ``UNARMED``: it would not do so
any more, because another program has written the register."""

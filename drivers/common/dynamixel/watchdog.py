"""Values of the bus watchdog (register 98), which stops a servo when its bus is silent.

The firmware stops a servo with torque if no instruction has arrived for the set time. The servo keeps its position
and its torque, sets the register to -1, and refuses goals until 0 is written. An arm thus has three lines of
defence. The wire process (which talks to the robot) stops the arm within 50 ms. The root (which supervises that
process) stops it within 150 ms. The firmware stops it if both processes have ended or the cable is cut.

*Any* instruction restarts the watchdog, even a read. So a process that only reads could let a servo drive to its
last goal without limit. Two rules prevent such a motion:

* The watchdog actor of the wire process requests each read. It requests none while the gate (which admits commands)
  or the transport does not answer.
* After a setpoint the wire process reads for ``FEED_S`` only, unless another setpoint, the same setpoint again or a
  stop frame (for limp or hold) follows. One of these follows as long as all processes work. The wire process also
  stops reading if a servo has answered a stop frame and still moves.

When it does not read, the wire process reports the last readings. These readings soon are too old, so the gate
refuses every move, and the firmware stops the arm. An arm that is limp or holds may be read without limit.

A servo that its watchdog has stopped is reported as a fault. Only the next ``resume()`` clears this state, with the
torque off. The vendor does not document how a servo treats its old goal if the state is cleared under torque.
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

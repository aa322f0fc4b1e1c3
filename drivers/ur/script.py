"""Our control script: its text, and the registers that command it and answer. Pure: no clock, no I/O except
reading ``control.script``.

The script runs on the controller. It replaces the script that ur-rtde uploads, and needs no SDK. Each
command is one RTDE packet that writes all of ``INPUTS``:

    input int 24      the order; each write of this register feeds the controller's watchdog
    input double 24+  the target of each joint, for ``SERVO``
    input int 25      the sequence number; it differs in each packet
    input int 26      the token of this upload; the script ignores packets with another token
    output int 24     the token, as soon as the script runs
    output int 25     its ``Phase``
    output int 26     the sequence number of the newest packet after which no servo motion continues

Registers keep their values when a program ends. So the script obeys only after the sequence number has
changed under its own token: values of an earlier connection move nothing.

Invariant: a target moves the arm for at most ``SILENT_S`` after its packet. Two watchdogs ensure it. The
script counts the time since the sequence number last changed, and ends in ``stopj``. The controller's own
watchdog ends the program after 1 / ``WATCHDOG_HZ``. It is needed where the speed slider slows the script down:
``servoj`` then takes longer than its time.
"""

from __future__ import annotations

import enum
from importlib import resources

from .arms import JOINTS
from .gates import CONTROL_S, LOOKAHEAD_S, WATCHDOG_HZ

FIRST = 24
"""First register that we use. Lower ones belong to fieldbus and PLC."""

GAIN = 300.0
"""Gain of servoj, 100 to 2000."""
STOP_RAD_S2 = 10.0
"""Deceleration when servoing ends."""

SILENT_S = 0.08
"""Longest time for which a packet is obeyed. It is shorter than that of the controller's watchdog, so that the
script's own ``stopj`` comes first."""
FIRST_WORD_S = 1.0
"""How long a script waits for its first packet. Then it ends, since it has no client any more."""

LAST_NUMBER = 2**31 - 1
"""Largest number in a register."""


class Order(enum.IntEnum):
    """The order of a packet. The numbers are those of ur-rtde's script, so that a wire log looks the same
    for both."""

    KEEP = 0
    """No new target. No servo motion continues."""
    SERVO = 11
    HOLD = 16
    """End servo motion."""
    END = 255
    """End the script."""


class Phase(enum.IntEnum):
    WAITS = 1
    """It waits for its first packet. Its watchdog is not armed yet."""
    READY = 2
    ENDED = 3


TARGETS = tuple(f"input_double_register_{FIRST + joint}" for joint in range(len(JOINTS)))
ORDER, SEQUENCE, TOKEN = (f"input_int_register_{FIRST + at}" for at in range(3))
INPUTS = (ORDER, *TARGETS, SEQUENCE, TOKEN)
RUNS, PHASE, HELD = (f"output_int_register_{FIRST + at}" for at in range(3))
ANSWERS = (RUNS, PHASE, HELD)


def next_number(number: int) -> int:
    """Return the sequence number after this one. It is never 0."""
    return number % LAST_NUMBER + 1


def has_reached(answered: int, number: int) -> bool:
    """Return True if the answered sequence number is this one or a later one."""
    return answered > 0 and (answered - number) % LAST_NUMBER < LAST_NUMBER // 2


def control_script(token: int) -> bytes:
    """Return the program for one upload. ``token``: 1 to ``LAST_NUMBER``, different in each upload."""
    text = (resources.files(__package__) / "control.script").read_text("ascii")
    return (
        text.partition("\n\n")[2]
        .format(
            token=token,
            order=FIRST,
            sequence=FIRST + 1,
            owner=FIRST + 2,
            runs=FIRST,
            phase=FIRST + 1,
            held=FIRST + 2,
            waits=int(Phase.WAITS),
            ready=int(Phase.READY),
            ended=int(Phase.ENDED),
            servo=int(Order.SERVO),
            end=int(Order.END),
            targets=", ".join(f"read_input_float_register({FIRST + joint})" for joint in range(len(JOINTS))),
            period=CONTROL_S,
            lookahead=LOOKAHEAD_S,
            gain=GAIN,
            stop=STOP_RAD_S2,
            silent=round(SILENT_S - 1.5 * CONTROL_S, 6),  # one period: reading is late; half: rounding to periods
            first=FIRST_WORD_S,
            watchdog=WATCHDOG_HZ,
        )
        .encode()
    )

"""Our control script: its text, and the registers through which it is commanded and answers.

The only I/O of this module is to read ``control.script``. The script runs on the controller. It replaces the script
that ur-rtde uploads, and needs no SDK. Each command is one RTDE packet that writes all of ``INPUTS``:

    input int 24      the order. Each write of this register feeds the controller's watchdog
    input double 24+  the target of each joint, for the order ``SERVO``
    input int 25      the sequence number, which differs in each packet
    input int 26      the token of this upload. The script ignores packets with another token
    output int 24     the token, as soon as the script runs
    output int 25     the ``Phase`` of the script
    output int 26     the sequence number of the newest packet whose order has ended the servo motion

Registers keep their values when a program ends. So a new script first waits until the sequence number changes in a
packet with its own token. Values from an earlier connection move nothing.

Invariant: a target moves the arm for at most ``SILENT_S`` after its packet. Two watchdogs ensure this. If the
sequence number does not change for this time, the script stops the arm by ``stopj`` and ends. The controller's own
watchdog ends the program after 1 / ``WATCHDOG_HZ``. The second one is needed if the speed slider slows the script
down, because ``servoj`` then takes longer.
"""

from __future__ import annotations

import enum
from importlib import resources

from .arms import JOINTS
from .gates import CONTROL_S, LOOKAHEAD_S, WATCHDOG_HZ

FIRST = 24
"""First register that this driver uses. Lower registers are reserved for a fieldbus or a PLC."""

GAIN = 300.0
"""Gain of servoj, 100 to 2000."""
STOP_RAD_S2 = 10.0
"""Deceleration when servoing ends."""

SILENT_S = 0.08
"""Longest time for which the script obeys one packet. It is shorter than the period of the controller's watchdog.
So the script itself stops the arm before this watchdog ends the script."""
FIRST_WORD_S = 1.0
"""How long a script waits for its first packet. After that it ends, because its client has gone."""

LAST_NUMBER = 2**31 - 1
"""Largest number in a register."""


class Order(enum.IntEnum):
    """The order in a packet. The numbers are those of ur-rtde's script, so that logs look alike."""

    KEEP = 0
    """Only feed the watchdog. A servo motion ends."""
    SERVO = 11
    HOLD = 16
    """End servo motion."""
    END = 255
    """End the script."""


class Phase(enum.IntEnum):
    WAITS = 1
    """The script waits for its first packet. Its watchdog is not armed yet."""
    READY = 2
    ENDED = 3


TARGETS = tuple(f"input_double_register_{FIRST + joint}" for joint in range(len(JOINTS)))
ORDER, SEQUENCE, TOKEN = (f"input_int_register_{FIRST + offset}" for offset in range(3))
INPUTS = (ORDER, *TARGETS, SEQUENCE, TOKEN)
RUNS, PHASE, HELD = (f"output_int_register_{FIRST + offset}" for offset in range(3))
ANSWERS = (RUNS, PHASE, HELD)


def next_number(number: int) -> int:
    """Return the sequence number that follows ``number``. It is never 0."""
    return number % LAST_NUMBER + 1


def has_reached(answered: int, number: int) -> bool:
    """Return True if ``answered`` is the sequence number ``number`` or a later one, with wrap-around."""
    return answered > 0 and (answered - number) % LAST_NUMBER < LAST_NUMBER // 2


def control_script(token: int) -> bytes:
    """Return the text of the script for one upload.

    ``token`` identifies the upload. It must differ in each upload, and be from 1 to ``LAST_NUMBER``.
    """
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
            # The script notices a new packet up to one period late, and it rounds times to half a period.
            silent=round(SILENT_S - 1.5 * CONTROL_S, 6),
            first=FIRST_WORD_S,
            watchdog=WATCHDOG_HZ,
        )
        .encode()
    )

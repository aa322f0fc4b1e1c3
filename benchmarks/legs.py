"""How regular is a G1 at 500 Hz (LowState in, LowCmd out), compared with a process that only runs
cyclonedds?"""

from __future__ import annotations

from .house import Figures, Goal, Question, Side, beside
from .stage import at_twin


def side(module: str, peer: str = "") -> Side:
    def ask(short: bool) -> Figures:
        return at_twin("unitree_g1", module, "short" if short else "long", peer=peer, timeout_s=180)

    return ask


QUESTION = Question(
    name="legs",
    title="Unitree G1 at 500 Hz",
    sides={
        "ours": side("legs_ours"),
        "cyclonedds 0.10.2": side("legs_cyclone", "cyclonedds"),
        "an empty tick": lambda short: beside("benchmarks.sides.legs_bare", "short" if short else "long"),
    },
    goals=(
        Goal("above_4_ms_pct", "", at_most=1.0),
        Goal("process_pct", "", at_most=30.0),
        Goal("process_pct", "cyclonedds 0.10.2", at_most=1.0),
    ),
    limit="""`process` is the wire process: RTPS, decoding, 29 limits and gains checked at every step, gate,
watchdog and beats. `root` is the process that monitors it. The wire process wakes with each setpoint, and handles
the watchdog's tick at the same time (`kernel/ticker.py`): some 550 wake-ups a second instead of 1000. Setpoints
come over zenoh, like those of every robot: zenoh's thread wakes, takes the interpreter's lock and wakes the loop.
Over a private socket, with actions by column, it was 12 to 15 % in the same hours in which this is 24 to 29. Gaps
on the wire were the same, so there is no such socket.

The machine decides the cost of a wake-up. `an empty tick` is trio waking 500 times a second without work. It took
2.2 % of a core on this machine in good hours, 3 to 4 in others, and 6 to 12 in bad ones. In those a wake-up took
30 to 40 µs in a C loop of `clock_nanosleep`, 56 in Python's `sleep`, 104 to 158 in trio. The process of
cyclonedds has no policy and checks nothing; its time is the encoding of 35 motors field by field, in Python.

The policy in the caller keeps its interpreter's lock for 30 of every 50 ms (`Spinner`), which makes setpoints
late. After 3 ms the watchdog sends the last one again. Gaps are measured where the twin reads; it shares the two
cores.""",
    ground="an empty tick",
    rounds=5,
)

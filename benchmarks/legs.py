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
watchdog and beats; `root` is the one that watches it. It wakes with each setpoint, and that brings the watchdog's
tick along (`kernel/ticker.py`): some 550 times a second instead of 1000. Setpoints come over zenoh, as everybody's
do: zenoh's thread wakes, takes the interpreter's lock and wakes the loop. Over a private socket, with actions by
column, it was 12 to 15 % in the same hours in which this is 24 to 29; gaps on the wire were the same, which is why
there is none. What a wake-up costs is the machine's: `an empty tick` is trio waking 500 times a second with
nothing to do, which took 2.2 % of a core on this machine in good hours, 3 to 4 in others, 6 to 12 in bad ones, in
which a wake-up took 30 to 40 µs in a C loop of `clock_nanosleep`, 56 in Python's `sleep`, 104 to 158 in trio. The
process of cyclonedds has no policy and checks nothing, its time goes into the encoding of 35 motors field by field,
in Python. The policy in the caller keeps its interpreter's lock for 30 of every 50 ms
(`Spinner`), which makes setpoints late; after 3 ms the watchdog sends the last one again. Gaps are what the twin
read; it shares the two cores.""",
    ground="an empty tick",
    rounds=5,
)

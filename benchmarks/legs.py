"""A G1 at 500 Hz: LowState in, LowCmd out, beside a process of cyclonedds that does nothing else."""

from __future__ import annotations

from benchmarks.house import Figures, Goal, Question, Side, beside
from benchmarks.stage import at_twin


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
        Goal("process_pct", "", at_most=15.0),
        Goal("process_pct", "cyclonedds 0.10.2", at_most=0.5),
    ),
    limit="""`process` is the wire process: RTPS, decoding, 29 limits and gains checked at every step, gate,
watchdog and beats; `root` is the one that watches it. It wakes with each setpoint, and that brings the watchdog's
tick along (`runtime/pace.py`): some 550 times a second instead of 1000. An action comes by column, without a dict
for each joint (`runtime/columns.py`). Measured in turns in the same hours, the first took 18 % to 15, the second 15
to 13.5. What a wake-up costs is the machine's: `an empty tick` is trio waking 500 times a second with nothing to
do, which took 2.2 % of a core on this machine in good hours, 3 to 4 in others, and 6 to 9 in bad ones, in which a
wake-up took 30 to 40 µs in a C loop of `clock_nanosleep`, 56 in Python's `sleep`, 104 to 158 in trio. Of a
setpoint's 250 µs here 80 are waking up and going to sleep; 30 are decoding and the gates, 45 encoding and sending,
55 hearing the robot; each takes half of that when nothing else runs on the machine in between. The process of
cyclonedds takes 2.4 to 3 times as much: it has no policy and checks nothing, its time goes into the encoding of 35
motors field by field, in Python. The policy in the caller keeps its interpreter's lock for 30 of every 50 ms
(`Spinner`), which makes setpoints late; after 3 ms the watchdog sends the last one again. Gaps are what the twin
read; it shares the two cores.""",
    ground="an empty tick",
    rounds=5,
)

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
        Goal("above_4_ms_pct", "", at_most=1.0, gross=20.0),
        Goal("process_pct", "", at_most=15.0),
        Goal("process_pct", "cyclonedds 0.10.2", at_most=0.5),
    ),
    limit="""`process` is the wire process: RTPS, decoding, 29 limits and gains checked at every step, gate,
watchdog and beats; `root` is the one that watches it. It wakes a thousand times a second, and what a wake-up
costs is the machine's: `an empty tick` is trio waking 500 times a second with nothing to do. That took 2.2 % of a
core on this machine in some hours, and ours 16 to 17 then; in others 6 to 9, and ours 22 to 29. In such an hour
a wake-up took 30 to 40 µs in a C loop of `clock_nanosleep`, 56 in Python's `sleep`, 104 to 158 in trio, of which
ours has one for each setpoint and one for each tick. Since then root and wire beat on a page they share: measured
in turns with the version before, 25.2 instead of 27.5 % for the wire, 8.6 instead of 10.8 for the root. In both the
process of cyclonedds takes 2.2 to 2.6 times as much: it has no policy and checks nothing, its time goes into the
encoding of 35 motors field by field, in Python. The policy in the caller keeps its interpreter's lock for 30 of
every 50 ms (`Spinner`). Gaps are what the twin read; it shares the two cores.""",
    ground="an empty tick",
    rounds=1,
)

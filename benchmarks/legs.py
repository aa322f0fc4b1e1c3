"""How regular are the 500 Hz commands to a Unitree G1 (LowState is read, LowCmd is written), compared with a
process that runs nothing but cyclonedds?
"""

from __future__ import annotations

from .house import Figures, Goal, Question, Side, beside
from .stage import run_with_twin


def side(module: str, peer: str = "") -> Side:
    def ask(short: bool) -> Figures:
        return run_with_twin("unitree_g1", module, "short" if short else "long", peer=peer, timeout_s=180)

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
    notice="""The robot gets its commands 500 times in a second, and four of ten thousand come more than 2 ms
late. This takes a quarter of a core; the vendor's DDS takes 42 % of one.""",
    limit="""`process` is the wire process, the only one that writes to the robot. The wire process runs the
network protocol (RTPS), decodes states, checks 29 limits and gains at every step, and supervises deadlines. `root`
is the process that monitors the wire process. The wire process wakes with each setpoint, and handles its periodic
checks at the same time (`kernel/ticker.py`): some 550 wake-ups per second instead of 1000. Setpoints come over
zenoh, like those of every robot: zenoh's thread wakes, takes the interpreter's lock, and wakes the loop. In a
trial, setpoints came over a private socket instead, with actions by column. The wire process then took 12 to 15 %
of a core, and with zenoh 24 to 29 % in the same hours. The gaps between commands were equal over zenoh and over
the private socket, so the package has no such socket.

The cost of a wake-up depends on the computer. `an empty tick` is a loop of trio that wakes 500 times per second
without work. On this computer `an empty tick` took 2.2 % of a core in good hours, 3 to 4 % in other hours, and 6
to 12 % in bad hours. In the bad hours a wake-up took 30 to 40 µs in a C loop of `clock_nanosleep`, 56 µs in
Python's `sleep`, and 104 to 158 µs in trio. The side with cyclonedds has no policy and checks nothing. The side
with cyclonedds spends its time on encoding 35 motors field by field, in Python.

The policy in the caller's process (`Spinner`) keeps the interpreter's lock of that process for 30 of every 50 ms,
which makes setpoints late. After 3 ms without a new setpoint the wire process sends the last setpoint again. The
gaps between commands are measured in the simulated robot, which shares the two cores with the other processes.""",
    ground="an empty tick",
    rounds=5,
)

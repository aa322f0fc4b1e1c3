"""How many seconds of a robot's whole tree pass in one of ours, in virtual time?"""

from __future__ import annotations

from benchmarks.house import Goal, Question, side_of

QUESTION = Question(
    name="virtual",
    title="How many seconds of a robot's whole tree pass in one of ours, in virtual time?",
    sides={"ours": side_of("virtual", "ours"), "two empty ticks": side_of("virtual", "ticks")},
    goals=(
        Goal("tree_x", "", at_least=100.0, gross=8.0),
        Goal("replayed_x", "", at_least=100.0, gross=8.0),
        Goal("same_trace", "", at_least=1.0, gross=1.0),
    ),
    ground="two empty ticks",
    limit="""Of 27 ms for a simulated second of an SO-101 (470 passes of trio's loop) trio and its virtual
clock are 34 %, the twin's servos with 500 steps of MuJoCo 19 %, actors and messages 19 %, the driver's codec and
gates 11 % (cProfile; the flame graph has the same). The same tree on a driver without wire and physics reaches
75. Two empty ticks of 100 Hz, 200 passes with nothing in them, reach 247: with 470 passes trio alone is at 105,
and no tree with this bus reaches 100 on this loop. The replay has no loop.""",
)

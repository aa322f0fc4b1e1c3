"""How many seconds of a robot's whole tree pass per real second, in virtual time?"""

from __future__ import annotations

from .house import Goal, Question, side_of

QUESTION = Question(
    name="virtual",
    title="How many seconds of a robot's whole tree pass in one of ours, in virtual time?",
    sides={
        "ours": side_of("virtual", "ours"),
        "its passes and physics": side_of("virtual", "passes"),
    },
    goals=(
        Goal("tree_x", "", at_least=100.0),
        Goal("replayed_x", "", at_least=100.0),
        Goal("same_trace", "", at_least=1.0),
    ),
    ground="its passes and physics",
    limit="""A simulated second of an SO-101 takes 26 ms (470 passes of trio's loop). trio and its virtual clock
are a third of that, the twin's servos with 500 steps of MuJoCo a sixth, actors and messages a fifth, the driver's
codec and gates a tenth (cProfile; the flame graph has the same). The same tree on a driver without wire and
physics reaches 66 to 75. `its passes and physics` is only one task that sleeps 470 times in a simulated second
and steps the same arm's physics: no tree with this bus reaches 100 on this loop. The replay has no loop.""",
)

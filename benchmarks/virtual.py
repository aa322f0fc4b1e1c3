"""How many seconds of a robot's operation can be simulated per real second, with all its actors in virtual time?"""

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
    notice="""A test that takes a minute on a robot takes 2 s, and an hour of a recording is replayed in 9 s.""",
    limit="""A simulated second of an SO-101 takes 26 ms (470 passes of trio's loop). trio and its virtual clock
take a third of these 26 ms, the simulated servos with 500 steps of MuJoCo a sixth, actors and messages a fifth,
and the driver's codec and checks a tenth (cProfile; the flame graph shows the same). With a driver without bus and
physics, the same actors simulate 66 to 75 seconds per real second. `its passes and physics` is only one task that
sleeps 470 times in a simulated second and steps the physics of the arm. `its passes and physics` shows that no
code with the bus of an SO-101 can simulate 100 seconds per real second on trio's loop. The figure `replayed` is
higher, because a replay needs no loop.""",
)

"""How much of a processor do the processes of one robot take, at rest and while it is commanded?"""

from __future__ import annotations

from .house import Goal, Question
from .stage import side_with_twins

QUESTION = Question(
    name="processor",
    title="Processor time of one robot",
    sides={"ours": side_with_twins({"so101": "so101", "unitree_g1": "g1"}, "processor")},
    goals=(
        Goal("so101_rest_pct", "", at_most=6.0),
        Goal("so101_stream_pct", "", at_most=9.0),
        Goal("g1_rest_pct", "", at_most=20.0),
    ),
    notice="""An SO-101 at rest takes a tenth of a core, and a seventh while a script commands it 50 times a
second. A robot with legs is read and commanded more often, so a G1 at rest takes a quarter of a core.""",
    limit="""The processes of an arm wake up 100 times a second to check deadlines, and to send the heartbeats
by which they notice each other's end within the published bounds. A robot with legs does it 250 times. The wire
process also reads the robot, 30 times a second for an SO-101. Two attempts were made. The root process has one
timer less, looks at the standby at its usual ticks, and reads `/proc` more cheaply: that is in these figures.
And 40 checks a second in place of 100 gave 8.5 % for an SO-101 at rest and 12.2 % while it is commanded. This
also misses the goals, and every bound would be 15 ms longer, so it was not kept.""",
    rounds=3,
)

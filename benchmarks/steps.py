"""How many steps of physics a second does a simulated SO-101 make, through the verbs?"""

from __future__ import annotations

from benchmarks.house import Goal, Question, side_of

QUESTION = Question(
    name="steps",
    title="How many steps of physics a second does a simulated SO-101 make, through the verbs?",
    sides={name: side_of("steps", name) for name in ("ours", "mj_step")},
    goals=(Goal("steps_per_s", "mj_step", at_least=0.8),),
    limit="""The goal means that verbs should not slow the physics down, and no verb lets it run: the twin steps
to the wall's clock, 500 times a second at its time step of 2 ms, because deadlines, leases and beats of the tree
are of that clock, and a simulation that ran ahead of it would show safe states at other moments than the robot.
The step is the same `mj_step` (5.8 µs, 170 000 a second); with 1457 commands and readings a second its process
does 3200 steps for each second it computes. Faster than the wall is virtual time (see `virtual`), in one process
and without the verbs.""",
    short=False,
)

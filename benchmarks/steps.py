"""How many steps of physics a second does a simulated SO-101 make, through the verbs?"""

from __future__ import annotations

from benchmarks.house import Goal, Question, side_of

QUESTION = Question(
    name="steps",
    title="How many steps of physics a second does a simulated SO-101 make, through the verbs?",
    sides={name: side_of("steps", name) for name in ("ours", "mj_step")},
    goals=tuple(
        Goal(f"{each}_per_s", "mj_step", at_least=0.8) for each in ("control_period", "second", "ten_seconds")
    ),
    limit="""A command and a `step` are a millisecond or two, whatever they ask for: two calls from the caller's
thread through its loop, gate, transport and the simulation's process, and back (see `setpoint`). Ten simulated
seconds a call (5000 steps, 30 ms of `mj_step`) hardly feel it; a second (500, 3 ms) loses a third to it, and a
control period (10 steps, 0.06 ms) is nothing beside it, though still several times as fast as the wall. Between
calls the physics keeps to the wall's clock, as deadlines, leases and beats of the tree always do; it steps in lots
of 500, so that a stop is not behind ten seconds.""",
    short=False,
)

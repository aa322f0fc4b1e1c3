"""How many physics steps per second does a simulated SO-101 make through the verbs?"""

from __future__ import annotations

from .house import Goal, Question, side_of

QUESTION = Question(
    name="steps",
    title="How many steps of physics a second does a simulated SO-101 make, through the verbs?",
    sides={
        "ours": side_of("steps", "ours"),
        "mj_step": side_of("steps", "mj_step"),
        "mj_step behind a socket": side_of("steps", "piped"),
    },
    goals=tuple(
        Goal(f"{each}_per_s", "mj_step", at_least=0.8) for each in ("control_period", "second", "ten_seconds")
    ),
    limit="""A `step` with an action is 0.45 to 0.55 ms, whatever it asks for: from the caller's thread to the wire
process (lease, gate, the driver's names and units), from there to the simulation's, and back, four wake-ups. Ten
simulated seconds a call (5000 steps, 24 ms of `mj_step`) do not feel it, a second (500, 2.4 ms) a little, and a
control period (10 steps, 0.05 ms) is nothing beside it, though still forty times as fast as the wall. That one is
out of reach for everybody whose physics is not in the script's own process, where a script that dies takes it
along: `mj_step behind a socket`, one process, bytes and nothing else, two wake-ups, is far from it, too. Ours is
faster than raw in long calls because a sixth of a raw step is MuJoCo's own stopwatch, which our twins do without.
Between calls the physics keeps to the wall's clock, as deadlines, leases and heartbeats of the tree always do;
it steps in lots of 500, so that a stop is not behind ten seconds.""",
    ground="mj_step behind a socket",
    short=False,
)

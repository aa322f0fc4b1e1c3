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
    limit="""A `step` with an action takes 0.45 to 0.55 ms, however many steps it has. The call goes from the
caller's thread to the wire process (lease, gate, the driver's names and units), from there to the simulation's,
and back: four wake-ups. In calls of ten simulated seconds (5000 steps, 24 ms of `mj_step`) that is negligible; in
calls of a second (500, 2.4 ms) it is small. A control period (10 steps, 0.05 ms) is much shorter than the call,
which is still forty times as fast as real time.

No library with physics outside the script's process can reach that last goal; inside it, the physics would die
with the script. `mj_step behind a socket` is one process, only bytes, two wake-ups, and also far from it. Ours is
faster than raw in long calls because a sixth of a raw step is MuJoCo's own stopwatch, which our twins omit.
Between calls the physics follows real time, as the tree's deadlines, leases and heartbeats always do. It steps in
batches of 500, so that a stop does not wait for ten seconds of physics.""",
    ground="mj_step behind a socket",
    short=False,
)

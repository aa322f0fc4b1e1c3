"""How many physics steps per second does a simulated SO-101 make when a script calls ``Robot.step``?"""

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
    notice="""Nothing with a policy, which asks once in 20 ms. A program that asks after every control period is
nine times slower than with MuJoCo itself, so it should compute many periods with each `step`.""",
    limit="""A call of `step` with an action takes 0.45 to 0.55 ms besides its physics, independent of the number
of physics steps. The call goes from the caller's thread to the wire process (checks, the driver's names and
units), from there to the process of the simulation, and back: four wake-ups. These 0.5 ms are negligible in calls
of ten simulated seconds (5000 steps, 24 ms of `mj_step`), and small in calls of one simulated second (500 steps,
2.4 ms of `mj_step`). In calls of one control period (10 steps, 0.05 ms of `mj_step`), the call takes much longer
than its physics, but is still forty times as fast as real time.

No library with physics outside the script's process can reach the goal for calls of one control period. With
physics inside the script's process, the simulated robot would end with the script. `mj_step behind a socket` needs
only one more process, messages of a few bytes and two wake-ups per call, and is also far from the goal for calls
of one control period. In calls of ten simulated seconds this package is faster than `mj_step` alone, because
MuJoCo's own stopwatch takes a sixth of the time of `mj_step`, and our simulated robots switch it off. Between
calls the physics follows real time, as deadlines, leases and heartbeats always do. The physics makes at most 500
steps at a time, so that a stop does not wait for ten seconds of physics.""",
    ground="mj_step behind a socket",
    short=False,
)

"""How long does a stop take between two processes during telemetry at full rate?"""

from __future__ import annotations

from .house import Goal, Question, side_of

QUESTION = Question(
    name="estop",
    title="How long does a stop take between two processes during telemetry at full rate?",
    sides={name: side_of("estop", name) for name in ("ours", "plain zenoh")},
    goals=(
        Goal("estop_p50_us", "", at_most=500.0),
        Goal("estop_p99_us", "", at_most=1_000.0),
    ),
    limit="""It takes 300 to 450 µs on an EPYC and 570 to 600 on a Xeon, and the version before was not faster;
`plain zenoh` takes 1,240 and 1,320. On the EPYC the sender's own call is 60 to 150 µs, because its telemetry
thread has the interpreter's lock nearly always (three quarters of all samples are that thread's: `Topic.put`,
`flood`, `wanted`). zenoh's threads and the other core's wake-up are 100 µs, and the receiver's loop 100 µs more
(time stamps at each hop). The p99 comes from the machine as well as from us: an ask over an idle zenoh has 0.6 ms
at p99 on it (`zenoh into trio` above). A plain callback during the same stream, `plain zenoh`, meets neither
goal.""",
    ground="plain zenoh",
    short=False,
    rounds=2,
)

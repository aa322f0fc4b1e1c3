"""How long does a stop message between two processes take while telemetry is sent at full rate?"""

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
    limit="""A stop takes 300 to 450 µs on an EPYC and 570 to 600 on a Xeon. The version before was not faster.
`plain zenoh` takes 1,240 and 1,320. On the EPYC the call that sends the stop takes 60 to 150 µs, because the
telemetry thread of the sender holds the interpreter's lock nearly always (three quarters of all samples are in its
functions `Topic.put`, `flood` and `wanted`). zenoh's threads and the wake-up of the other core take 100 µs, and
the receiver's loop another 100 µs (measured with a time stamp after each step). A part of the p99 is the
computer's: a request over an idle zenoh has a p99 of 0.6 ms on it (`zenoh into trio` in the question on two
processes). `plain zenoh`, a callback that gets its stops during the same telemetry, meets neither goal.""",
    ground="plain zenoh",
    short=False,
    rounds=2,
)

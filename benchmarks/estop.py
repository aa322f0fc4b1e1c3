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
    notice="""Nothing: with both sides a stop arrives faster than a person can see (10 ms). Beside telemetry at
full rate, the stop of this package arrives in half of the time.""",
    limit="""A stop takes 300 to 450 µs on an EPYC and 570 to 600 on a Xeon. The previous version of this package
was not faster. A stop with `plain zenoh` takes 1,240 µs on the EPYC and 1,320 µs on the Xeon. On the EPYC the call
that sends the stop takes 60 to 150 µs, because the telemetry thread of the sender holds the interpreter's lock
nearly always (three quarters of all samples are in its functions `Topic.put`, `flood` and `wanted`). Of the time
of a stop, zenoh's threads and the wake-up of the other core take 100 µs, and the receiver's loop another 100 µs
(measured with a time stamp after each step). The computer itself causes a part of the p99, because on this
computer a request over an idle zenoh already has a p99 of 0.6 ms (`zenoh into trio` in the section on an ask
between two processes). `plain zenoh`, a callback that gets its stops during the same telemetry, meets neither
goal.""",
    ground="plain zenoh",
    short=False,
    rounds=2,
)

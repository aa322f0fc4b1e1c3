"""Where does the time of one setpoint go, between the call and the wire?"""

from __future__ import annotations

from benchmarks.house import Goal, Question, side_of

QUESTION = Question(
    name="hops",
    title="Where does the time of one setpoint go, from `send_action` to the robot's first byte?",
    sides={"ours": side_of("hops", "ours")},
    goals=(Goal("total_p99_us", "", at_most=5_000.0),),
    limit="""Wake-ups, of which none is computing: the caller's loop (170 to 220 µs, with the interpreter's
lock), the wire process (55 to 70 µs) and the twin behind its pty (120 to 170 µs). What is computed on the way,
the lease and the encoding, the gate's checks, the driver's gates and the codec, is 160 to 190 µs in two of three
runs, with caches that are cold after 20 ms of sleep. The stamps are of one clock, over 500 setpoints.""",
    short=False,
)

"""Where does the time of one setpoint go, between the call and the wire?"""

from __future__ import annotations

from benchmarks.house import Goal, Question, side_of

QUESTION = Question(
    name="hops",
    title="Where does the time of one setpoint go, from `send_action` to the robot's first byte?",
    sides={"ours": side_of("hops", "ours")},
    goals=(Goal("total_p99_us", "", at_most=5_000.0),),
    limit="""Wake-ups, of which none is computing: the wire process (80 to 100 µs) and the twin behind its pty
(150 to 190 µs). What is computed on the way, the lease and the encoding (110 µs), the gate's checks, the
driver's gates and the codec (210 µs), takes two to three times as long with caches that are cold after 20 ms of
sleep as in a script that calls without pause, where the call is answered after 125 µs. The caller's loop, 376
µs of 1109 when a command went by it (on an EPYC; 170 to 220 in better hours), is past. The stamps are of one
clock, over 500 setpoints.""",
    short=False,
)

"""From ``send_action`` to the first byte on the wire, beside the reference's call in the caller's own thread."""

from __future__ import annotations

from benchmarks.house import Goal, Question
from benchmarks.stage import at_twins

ROBOTS = {"so101": "feetech", "ur5e": "ur"}

QUESTION = Question(
    name="setpoint",
    title="From `send_action` to the first byte on the wire",
    sides={
        "ours": at_twins(ROBOTS, "setpoint", "ours"),
        "strands-robots": at_twins(ROBOTS, "setpoint", "strands", peer="strands"),
        "raw SDK": at_twins(ROBOTS, "setpoint", "sdk"),
        "a process with the SDK": at_twins(ROBOTS, "setpoint", "process"),
    },
    goals=(
        # late: the p99; beside us that of the reference and the millisecond that we may be behind it
        Goal("feetech_late_us", "strands-robots", at_most=1.0),
        Goal("ur_late_us", "strands-robots", at_most=1.0),
    ),
    limit="""Half of the median is waking up: stamped hop by hop on a quiet machine, 0.25 ms from the call to
the caller's loop (0.03 ms when called again at once; a blocked thread alone wakes in 0.06), 0.18 to the gate in
the wire process, 0.11 to the transport, 0.06 to the bus; a third of all samples are in epoll. The p99 on Feetech's
half-duplex bus is a line in use: a setpoint waits for the end of a reading (1.5 ms, 30 a second; so it was in eight
of the ten slowest of 400), while the reference in this comparison neither reads nor repeats anything. On a UR it is
waking up again: the 18 slowest of 1800, stamped, were 1.3 ms behind the median, 0.8 of it between the call and the
gate (two processes that slept), 0.25 in the thread that may wait for ur-rtde, 0.25 from there to the twin. Three
stood behind the repeated setpoint before them; to repeat it a third as often changed nothing. `a process with the
SDK` is what anybody pays whose robot is read, or fed, by a process that outlives the script, without gates, leases
and deadlines: on Feetech's bus its p99 is behind ours, on a UR it was at the goal (0.72 and 1.02 of it in two
runs). What that buys: the caller can be killed, frozen or computing, and the wire still shows the safe state.
`late` is the p99; beside us it is that of the reference plus the millisecond that the goal allows.""",
    ground="a process with the SDK",
    rounds=2,
)

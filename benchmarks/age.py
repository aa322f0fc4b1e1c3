"""How old is a setpoint when a reader that takes 5 ms for each gets it from a producer of 1 kHz?"""

from __future__ import annotations

from benchmarks.house import Goal, Question, side_of

QUESTION = Question(
    name="age",
    title="How old is a setpoint of a 1 kHz producer when a reader takes it that needs 5 ms for each?",
    sides={"ours": side_of("age", "ours"), "trio": side_of("age", "trio")},
    goals=(
        Goal("age_p99_us", "", at_most=1_500.0, gross=10.0),
        Goal("waiting_most", "", at_most=1.0),
    ),
    limit="""The producer's period: a reader that is done at any moment finds a setpoint of 0 to 1 ms, half a
period in the median, since the newest has taken the place of the others. The rest is the way: one system call,
one wake-up of the reader's loop (55 µs in `hops`), and the return of the thread that the reader was busy in.
With other work on both cores these stand in line: p99 was 1.1 to 2.8 ms at loads of 2 to 5.""",
    rounds=3,
)

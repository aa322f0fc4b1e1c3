"""Of how many robots does one computer publish the telemetry, and how much does each cost?"""

from __future__ import annotations

from . import peers
from .house import Figures, Goal, Question, Side, beside


def side(who: str, peer: str = "") -> Side:
    def ask(short: bool) -> Figures:
        python = {"python": peers.python(peer)} if peer else {}
        return beside("benchmarks.sides.telemetry", who, "short" if short else "long", timeout_s=420, **python)

    return ask


QUESTION = Question(
    name="telemetry",
    title="Robots on one machine, each publishing its state ten times a second",
    sides={
        "ours": side("ours"),
        "strands-robots": side("strands", "strands"),
        "two empty ticks each": lambda short: beside(
            "benchmarks.sides.telemetry_ticks", "short" if short else "long"
        ),
    },
    goals=(
        Goal("robots_per_core", "strands-robots", at_least=5.0),  # the short form starts two
        Goal("threads_per_robot", "", at_most=0.0),
    ),
    limit="""The processor. Each of our robots is two processes that check deadlines and send beats 100 times a
second, whether the robot moves or not: 6 to 9 % of a core and 35 to 49 MB. Two fifths of that is waking up (epoll
in the flame graph). Each of the reference's robots is 15 threads of the caller that are idle between their ten
states a second: 2 to 3 %. No process monitors those threads. 48 to 64 of them, the most that are started here,
still send their states in time.

Five times as many robots would leave 0.6 to 0.8 % of a core for each of ours. `two empty ticks each` is the cost
of two processes that only wake up 100 times a second, scaled to a whole core: that alone misses the goal. So a
tree of processes that notice each other's death within 50 ms cannot reach it, and threads of the caller do not
give that protection.""",
    ground="two empty ticks each",
    rounds=1,
)

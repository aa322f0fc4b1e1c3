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
    title="Robots on one machine, each telling its state ten times a second",
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
    limit="""The processor: each of our robots is two processes that look at deadlines, and beat, 100 times a
second, whether it moves or not, 6 to 9 % of a core and 35 to 49 MB, two fifths of it waking up (epoll in the
flame graph); each of the reference's is 15 threads of the caller that do nothing between their ten states a
second, 2 to 3 %. Nobody watches those: 48 to 64 of them, the most that are started here, still tell in time.
Five times as many robots would leave each of ours 0.6 to 0.8 % of a core. `two empty ticks each` is what two
processes cost that only wake 100 times a second and do nothing, reckoned to a whole core: that alone misses the
goal. So it is out of reach of a tree of processes that see each other's death within 50 ms; no thread of the
caller is what that gives.""",
    ground="two empty ticks each",
    rounds=1,
)

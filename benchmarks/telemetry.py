"""For how many robots can one computer publish the states, and how much memory and time does each need?"""

from __future__ import annotations

from . import peers
from .house import Figures, Goal, Question, Side, beside


def side(program: str, peer: str = "") -> Side:
    def ask(short: bool) -> Figures:
        python = {"python": peers.python(peer)} if peer else {}
        return beside("benchmarks.sides.telemetry", program, "short" if short else "long", timeout_s=420, **python)

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
        # The short form starts only two robots, so this goal has no meaning there.
        Goal("robots_per_core", "strands-robots", at_least=5.0),
        Goal("threads_per_robot", "", at_most=0.0),
    ),
    notice="""One core carries 16 robots instead of 24, and each robot needs 36 MB, because it has several
processes. If one of them dies, another one stops the robot.""",
    limit="""The processor is the limit. Each of our robots has two processes that check deadlines and send
heartbeats 100 times per second, also at rest. Both processes together take 6 to 9 % of a core and 35 to 49 MB. Two
fifths of this processor time are wake-ups (epoll in the flame graph). Each robot of strands-robots is 15 threads of
the caller, which are idle between their ten states per second and take 2 to 3 % of a core. No process monitors the
threads of strands-robots. The 48 to 64 robots of strands-robots, the most that this benchmark starts, still send
their states in time.

The goal, five times as many robots per core as strands-robots, would leave 0.6 to 0.8 % of a core for each of our
robots. `two empty ticks each` is the cost of two processes that only wake up 100 times per second, scaled to a
whole core. Two such processes per robot alone miss the goal of five times as many robots, so processes that notice
each other's end within 50 ms cannot reach this goal. Threads in the caller's process give no such protection,
because they end with the caller.""",
    ground="two empty ticks each",
    rounds=1,
)

"""How long does an ask with a deadline take, in one process?"""

from __future__ import annotations

from benchmarks.house import Figures, Goal, Question, beside
from benchmarks.sides.erlang import erlang


def _side(name: str, short: bool) -> Figures:
    return beside("benchmarks.sides.ask", name, *(["short"] if short else []))


QUESTION = Question(
    name="ask",
    title="How long does an ask with a deadline take, in one process?",
    sides={
        "ours": lambda short: _side("ours", short),
        "trio": lambda short: _side("trio", short),
        "asyncio": lambda short: _side("asyncio", short),
        "pykka": lambda short: _side("pykka", short),
        "erlang": lambda short: erlang("ask", short),
    },
    goals=(
        Goal("ask_p50_us", "trio", at_most=0.35),
        Goal("ask_p50_us", "pykka", at_most=0.11),
        Goal("ask_p99_us", "trio", at_most=0.35),
    ),
    limit=(
        "An idle actor with a synchronous handler answers in the asker's own turn, without a pass of the "
        "scheduler (one pass: 4 µs and a system call; trio's side needs two, with a scope for the "
        "deadline); every 32nd ask lets other tasks run, which is the p99."
    ),
)

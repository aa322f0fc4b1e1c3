"""How long does an ask with a deadline take, in one process?"""

from __future__ import annotations

from .house import Goal, Question, side_of
from .sides.erlang import erlang

QUESTION = Question(
    name="ask",
    title="How long does an ask with a deadline take, in one process?",
    sides={
        "ours": side_of("ask", "ours"),
        "trio": side_of("ask", "trio"),
        "asyncio": side_of("ask", "asyncio"),
        "pykka": side_of("ask", "pykka"),
        "erlang": lambda short: erlang("ask", short),
    },
    goals=(
        Goal("ask_p50_us", "trio", at_most=0.35),
        Goal("ask_p50_us", "pykka", at_most=0.11),
        Goal("ask_p99_us", "trio", at_most=0.35),
    ),
    limit=(
        """An idle actor with a synchronous handler answers in the asker's own turn, without a pass of the
scheduler. (One pass costs 4 µs and a system call; trio's side needs two, with a scope for the deadline.) Every
32nd ask lets other tasks run, which gives the p99."""
    ),
)

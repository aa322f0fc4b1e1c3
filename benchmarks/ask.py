"""How long does a request to an actor in the same process take, with a deadline for the answer?"""

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
    notice="""Nothing: a question inside a process costs some millionths of a second with each side but pykka.
The wire process of a robot asks some hundred questions in a second.""",
    limit=(
        """If the actor is idle and its handler is synchronous, the handler runs inside the asking task, without a
pass of trio's scheduler. (One pass of the scheduler costs 4 µs and a system call. For each request, the side
`trio` needs two passes, and a cancel scope for the deadline.) Every 32nd request lets other tasks run, so it takes
longer and determines the p99."""
    ),
)

"""How long does it take to start the process of an actor, and to replace one that was killed?"""

from __future__ import annotations

from .house import Goal, Question, side_of
from .sides.erlang import erlang

QUESTION = Question(
    name="life",
    title="How fast does an actor start in a separate process, and how fast does it restart there?",
    sides={
        **{name: side_of("life", name) for name in ("ours", "trio", "multiprocessing", "ray")},
        "erlang": lambda short: erlang("restart", short),
    },
    goals=(
        Goal("spawn_p50_ms", "", at_most=12.0),
        Goal("recover_p50_ms", "", at_most=15.0),
        Goal("restart_p50_us", "erlang", at_most=1.0),
    ),
    limit="""A start is a fork (1.3 ms), the start of trio, a connection and one message. The forked heap is frozen
before the fork, because its garbage collection would take 10 ms. A restart within the process is as fast as trio
allows: `trio` is a task that raises, a loop that starts it again, and one answer with a deadline. It does not
limit or report restarts, and takes as long as this package. Erlang's processes have no stack of coroutines.""",
    short=False,
    ground="trio",
    rounds=2,
)

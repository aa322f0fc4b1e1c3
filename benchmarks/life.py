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
    notice="""A crashed process is replaced in 9 ms, before most robots notice that no command comes. With
`multiprocessing` this takes a seventh of a second, and a stream of commands breaks off.""",
    limit="""The start of an actor's process is a fork (1.3 ms), the start of trio, a connection and one message.
The heap is excluded from garbage collection before the fork (`gc.freeze`), because its collection would take 10 ms
in the new process. A restart of an actor within its process is as fast as trio allows. The side `trio` is only a
task that raises, a loop that starts the task again, and one answer with a deadline. A restart takes as long in the
side `trio` as in this package, although `trio` does not limit or report restarts. Erlang restarts faster, because
its processes have no stack of coroutines.""",
    short=False,
    ground="trio",
    rounds=2,
)

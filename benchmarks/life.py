"""How fast does an actor's process start, and how fast is what died there again?"""

from __future__ import annotations

from benchmarks.house import Figures, Goal, Question, Side, beside
from benchmarks.sides.erlang import erlang


def _side(name: str) -> Side:
    def side(short: bool) -> Figures:
        return beside("benchmarks.sides.life", name, *(["short"] if short else []))

    return side


QUESTION = Question(
    name="life",
    title="How fast does an actor start in a process of its own, and how fast is one that died there again?",
    sides={
        **{name: _side(name) for name in ("ours", "trio", "multiprocessing", "ray")},
        "erlang": lambda short: erlang("restart", short),
    },
    goals=(
        Goal("spawn_p50_ms", "", at_most=12.0),
        Goal("recover_p50_ms", "", at_most=15.0),
        Goal("restart_p50_us", "erlang", at_most=1.0),
    ),
    limit="""A birth is a fork (1.3 ms), the collection of the forked heap before the child begins (10 ms: it
walks and thereby copies what the spawner has imported), trio's start, a link and one message; forks timed alone,
at a load of 2. With a heap that is frozen before the fork the collection is 0.02 ms, and in the same minutes a
birth 6 to 9 ms instead of 15 to 22. A restart in the process is six passes of trio's scheduler, 4 µs each, and
four cancel scopes.""",
    short=False,
    ground="trio",
    rounds=2,
)

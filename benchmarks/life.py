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
        **{name: _side(name) for name in ("ours", "multiprocessing", "ray")},
        "erlang": lambda short: erlang("restart", short),
    },
    goals=(
        Goal("spawn_p50_ms", "", at_most=12.0),
        Goal("recover_p50_ms", "", at_most=15.0),
        Goal("restart_p50_us", "erlang", at_most=1.0),
    ),
    limit=(
        "A process is executed and imports trio, zenoh and msgspec: 120 ms; the same actor forked from a "
        "warm process speaks after 7 ms. A restart is six passes of trio's scheduler, 4 µs each, and four "
        "cancel scopes."
    ),
    short=False,
    rounds=2,
)

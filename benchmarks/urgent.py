"""How long does a stop wait behind 10 000 queued messages of 20 us each?"""

from __future__ import annotations

from benchmarks.house import Figures, Goal, Question, beside


def _side(name: str, short: bool) -> Figures:
    return beside("benchmarks.sides.urgent", name, *(["short"] if short else []))


QUESTION = Question(
    name="urgent",
    title="How long does a stop wait behind 10 000 queued messages of 20 µs each?",
    sides={
        "ours": lambda short: _side("ours", short),
        "trio": lambda short: _side("trio", short),
        "pykka": lambda short: _side("pykka", short),
    },
    goals=(Goal("urgent_p50_us", "", at_most=70.0, gross=10.0),),
    limit=(
        "The handler that runs (20 µs), and at most a turn of 200 µs when the sender is a task of the same loop."
    ),
)

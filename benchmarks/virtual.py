"""How many seconds of a robot's whole tree pass in one of ours, in virtual time?"""

from __future__ import annotations

from benchmarks.house import Figures, Goal, Question, beside


def _ours(short: bool) -> Figures:
    return beside("benchmarks.sides.virtual", "ours", *(["short"] if short else []))


QUESTION = Question(
    name="virtual",
    title="How many seconds of a robot's whole tree pass in one of ours, in virtual time?",
    sides={"ours": _ours},
    goals=(
        Goal("tree_x", "", at_least=100.0, gross=8.0),
        Goal("replayed_x", "", at_least=100.0, gross=8.0),
        Goal("same_trace", "", at_least=1.0, gross=1.0),
    ),
    limit=(
        "Two tickers of 100 Hz alone, without a tree, make 212 simulated seconds a second: trio's timers "
        "and its virtual clock. The tree is 500 passes of the scheduler and 600 messages a simulated "
        "second, each message reading the clock five times."
    ),
)

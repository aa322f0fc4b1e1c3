"""How many steps of physics a second does a simulated SO-101 make, through the verbs?"""

from __future__ import annotations

from benchmarks.house import Figures, Goal, Question, Side, beside


def _side(name: str) -> Side:
    def side(short: bool) -> Figures:
        return beside("benchmarks.sides.steps", name, *(["short"] if short else []))

    return side


QUESTION = Question(
    name="steps",
    title="How many steps of physics a second does a simulated SO-101 make, through the verbs?",
    sides={name: _side(name) for name in ("ours", "mj_step")},
    goals=(Goal("steps_per_s", "mj_step", at_least=0.8),),
    limit=(
        "The physics keeps to wall time whatever is asked: 500 steps a second at a time step of 2 ms. No "
        "verb makes time pass faster, since the deadlines of the tree are of the wall's clock."
    ),
    short=False,
)

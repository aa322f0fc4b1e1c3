"""How much of a processor do a host and its metrics take beside twelve robots?"""

from __future__ import annotations

from .house import Figures, Goal, Question, beside


def ours(short: bool) -> Figures:
    return beside("benchmarks.sides.hosting", "short" if short else "long", timeout_s=300)


QUESTION = Question(
    name="hosting",
    title="A host with its metrics, beside twelve SO-101 arms",
    sides={"ours": ours},
    goals=(Goal("together_pct", "", at_most=25.0),),
    notice="""A host and its metrics for twelve arms take a tenth of a core. No robot waits for either.""",
    limit="""The metrics decode the samples of all robots in Python, and write all figures at each collection,
here once a second. The host only asks each robot's guardian whether it answers.""",
    rounds=1,
)

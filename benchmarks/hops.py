"""Where does the time of one setpoint go, between the call and the wire?"""

from __future__ import annotations

from benchmarks.house import Figures, Goal, Question, beside


def _ours(short: bool) -> Figures:
    return beside("benchmarks.sides.hops", "ours", *(["short"] if short else []))


QUESTION = Question(
    name="hops",
    title="Where does the time of one setpoint go, from `send_action` to the robot's first byte?",
    sides={"ours": _ours},
    goals=(Goal("total_p99_us", "", at_most=5_000.0),),
    limit=("To be written."),
    short=False,
)

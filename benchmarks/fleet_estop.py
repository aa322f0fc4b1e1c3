"""How long does one e-stop to twelve arms take, until the last arm has its safe frame?"""

from __future__ import annotations

from .house import Figures, Goal, Question, beside


def ours(short: bool) -> Figures:
    return beside("benchmarks.sides.fleet_estop", "short" if short else "long", timeout_s=300)


QUESTION = Question(
    name="fleet_estop",
    title="One e-stop to twelve SO-101 arms",
    sides={"ours": ours},
    goals=(
        Goal("not_safe", "", at_most=0.0),
        Goal("last_frame_p50_ms", "", at_most=50.0),
        Goal("results_worst_ms", "", at_most=250.0),
    ),
    notice="""The last arm gets its safe frame a moment after the first. The results of all arms are with the
program that pressed before a person can look up.""",
    limit="""The computer is the limit: the twelve arms and their twins are 48 processes, which all wake up at the
same moment. Two cores were in use nearly all the time before the press, since each twin computes the physics of its
arm, and the arms move.""",
    rounds=1,
)

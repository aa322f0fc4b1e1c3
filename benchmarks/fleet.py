"""Can one process command twelve arms, each 20 times per second, with the simulated arms on the same computer?"""

from __future__ import annotations

from .house import Figures, Goal, Question, beside


def ours(short: bool) -> Figures:
    return beside("benchmarks.sides.fleet", "short" if short else "long", timeout_s=180)


QUESTION = Question(
    name="fleet",
    title="Twelve SO-101 arms from one process",
    sides={"ours": ours},
    goals=(
        Goal("left_armed", "", at_most=0.0),
        Goal("restarts", "", at_most=0.0),
        Goal("answer_p50_ms", "", at_most=20.0),
    ),
    notice="""Twelve arms answer within 9 ms on two cores, and no arm is stopped by mistake. A real arm needs 28
MB of memory, and its twin another 35 MB.""",
    limit="""The computer is the limit, because twelve robots are 36 processes, and a third of these processes are
simulated robots with physics. Figures in percent are shares of one core, for one robot. `mb` is the proportional
set size, in which shared memory counts once.""",
    rounds=1,
)

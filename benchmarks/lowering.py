"""How fast does a raised arm reach the table when its script is killed, and how soon is it limp?"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from .house import Figures, Goal, Question, Side, beside

ROBOTS = ("so101", "koch")
TRIALS = 10
"""Trials of each way in a round, for each robot. Ten rounds are two hundred trials of each way."""
FALLS = 2
"""The same for arms that are not lowered, which are only there for comparison."""


def side(end: str) -> Side:
    """Return the side with this ``on_exit``."""

    def run(short: bool) -> Figures:
        trials = "1" if short else str(TRIALS if end == "lower" else FALLS)

        def of(robot: str) -> Figures:
            found = beside("benchmarks.sides.lowering", robot, end, trials, timeout_s=600)
            return {f"{robot}_{name}": value for name, value in found.items()}

        figures: Figures = {}
        with ThreadPoolExecutor() as pool:
            for each in pool.map(of, ROBOTS):
                figures |= each
        return figures

    return run


QUESTION = Question(
    name="lowering",
    title="A raised arm whose script is killed",
    sides={"ours": side("lower"), "limp": side("limp")},
    goals=tuple(
        Goal(f"{robot}_{figure}", "", at_most=limit)
        for robot in ROBOTS
        for figure, limit in (
            ("killed_touch_m_s", 0.15),
            ("killed_limp_s", 3.0),
            ("killed_setpoints_after", 0.0),
            ("estop_limp_ms", 50.0),
            ("estop_setpoints_after", 0.0),
            ("mute_limp_ms", 50.0),
            ("mute_setpoints_after", 0.0),
        )
    ),
    notice="""An arm that is held raised when its script is killed comes to lie on the table instead of falling on
it. Each figure is the worst of ten trials, and the range shows the worst of all rounds.""",
    limit="""The time until the arm is limp is what it needs to come down: at most 2.8 s (`lower_s`). A servo that
falls mute is noticed by the next of 50 readings a second, when the longest time for its answer is over: 20 ms and
27 ms at most, and the frame that switches the torque off. The Koch's frames are longer, so it misses the goal by
6 ms. More readings a second would help, and were not measured.""",
    rounds=10,
    short=False,
)

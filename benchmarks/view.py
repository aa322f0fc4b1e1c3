"""Does a live view delay the setpoints of the robot that it shows, and how soon does it show the robot?"""

from __future__ import annotations

from .house import Goal, Question
from .stage import side_with_twins

QUESTION = Question(
    name="view",
    title="Setpoints beside a live view",
    sides={"ours": side_with_twins({"so101": "so101", "ur5e": "ur"}, "view", timeout_s=300)},
    goals=tuple(
        goal
        for prefix in ("so101", "ur")
        for goal in (
            Goal(f"{prefix}_p99_ratio", "", at_most=1.05),
            Goal(f"{prefix}_first_frame_s", "", at_most=1.0),
        )
    ),
    notice="""A view changes the delay of setpoints by less than the runs differ from each other, and shows the
robot within half a second after a program has connected to it.""",
    limit="""The view is a separate process that only subscribes to the robot's telemetry. It shares the
computer with the robot, and takes 2 to 3 % of a core.""",
    rounds=2,
    short=False,
)

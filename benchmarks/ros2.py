"""What does the bridge to a ROS 2 graph cost, and how long does a stop over it take?"""

from __future__ import annotations

from .house import Figures, Goal, Question, beside

HOLD_MS = 150.0
"""The lifetime of a setpoint, and the bound of the SO-101."""


def ours(short: bool) -> Figures:
    return beside("benchmarks.sides.ros2", "short" if short else "long", timeout_s=900)


QUESTION = Question(
    name="ros2",
    title="Twelve robots and a camera on a ROS 2 graph, and a stop from the graph",
    sides={"ours": ours},
    goals=(
        Goal("bridge_cores", "", at_most=0.5),
        Goal("stop_max_ms", "", at_most=50.0),
        Goal("hold_kill_max_ms", "", at_most=HOLD_MS),
        Goal("hold_freeze_max_ms", "", at_most=HOLD_MS),
        Goal("setpoints_after", "", at_most=0.0),
    ),
    notice="""`strands-actors ros2` needs a part of one core, and robots do not wait for it. A stop from the graph
passes a router and one more process, and is still sent within milliseconds.""",
    limit="""The bridge decodes JSON and encodes CDR, both in Python. Topics without a subscriber cost nothing.""",
    rounds=1,
    short=False,
)

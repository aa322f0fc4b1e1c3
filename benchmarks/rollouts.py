"""Do policies at 500 Hz keep their rate, and does a robot with legs ever lose its policy for no reason?"""

from __future__ import annotations

from .house import Goal, Question
from .stage import side_with_twins

ROBOTS = {"unitree_go2": "go2", "unitree_g1": "g1", "unitree_h1": "h1"}

QUESTION = Question(
    name="rollouts",
    title="Policies on the joints of robots with legs, at 500 Hz",
    sides={"ours": side_with_twins(ROBOTS, "rollouts_ours", timeout_s=300)},
    goals=tuple(
        goal
        for prefix in ROBOTS.values()
        for goal in (
            Goal(f"{prefix}_steps_per_s", "", at_least=495.0),
            Goal(f"{prefix}_ended_early", "", at_most=0.0),
        )
    ),
    limit="",
    rounds=7,
)

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
    notice="""With a policy that returns one action at a time the robot moves a little slower than the policy
intends, since each action lasts longer than 2 ms. A robot whose rollout ends early stands still until it is
started again.""",
    limit="""A policy that computes for 0.2 ms and returns one action at a time needs an observation for every
step. A step takes 1.1 ms of the processor in the script's process, of which the policy takes 0.2 ms. The rest
is spent in task switches of trio and in waiting for the interpreter's lock, which the threads of the script
share. The simulated robot and the wire process run on the same two cores. So the process is often late, and a
period that has passed is not made up for. With 25 actions at a time the rate is 477 to 488 steps per second.

A rollout ends early if no setpoint comes for 0.1 s. On a computer with other work the process of the policy
waited 40 to 80 ms for a processor, and sometimes longer.""",
    rounds=7,
)

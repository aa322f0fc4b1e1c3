"""How long does it take to plan a motion of an arm's tool to a pose, and how exact is the plan?"""

from __future__ import annotations

from .house import Goal, Question, side_of

ROBOTS = ("ur5e", "panda", "xarm7", "kinova_gen3", "kuka_iiwa", "so101")

QUESTION = Question(
    name="poses",
    title="How long does a plan to a pose take, and how exact is it?",
    sides={"ours": side_of("poses", "ours")},
    goals=tuple(
        goal
        for robot in ROBOTS
        for goal in (
            Goal(f"{robot}_found_pct", "", at_least=100.0),
            Goal(f"{robot}_p95_ms", "", at_most=20.0),
            Goal(f"{robot}_off_mm", "", at_most=1.0),
            Goal(f"{robot}_turned_deg", "", at_most=0.5),
            Goal(f"{robot}_bent_mm", "", at_most=2.0),
            Goal(f"{robot}_refused_pct", "", at_least=100.0),
        )
    ),
    notice="""`move_to(xyz=...)` begins to move some hundredths of a second after the call. The figures are of
plans. How exactly a real arm follows its plan depends on its own controller: an SO-101 yields to its weight by
some millimetres.""",
    limit="""`found`, `p50`, `p95`, `off` and `turned` are of 200 random poses that the arm reaches without touching
itself, each planned from the arm's home position with `linear=False`. `off` and `turned` are the largest distance
and turn between a requested and a planned pose. The poses of so101 are poses of its five joints. `bent` is the
largest distance of a planned setpoint from a straight line, of 40 lines of 10 cm. `refused` is the share of 40
poses outside the reach that are refused. Most of the time is spent in numpy: one step of a search takes 60 to
100 µs, and most searches end after 10 steps. The longest plans are those whose first starts lead to no
solution.""",
    rounds=3,
)

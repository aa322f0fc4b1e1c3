"""How long does it take to plan a motion of an arm's tool to a pose, and how exact is the plan?"""

from __future__ import annotations

import tempfile
from pathlib import Path

from . import peers
from .house import Figures, Goal, Question, Side, beside

LIBRARIES = ("pinocchio", "mink", "ikpy")
ROBOTS = ("ur5e", "panda", "xarm7", "kinova_gen3", "kuka_iiwa", "so101")

LONGEST_S = 600.0
"""Longest time of one side for all poses, on a busy computer."""


def ours(short: bool) -> Figures:
    return beside("benchmarks.sides.poses", "ours", *(["short"] if short else []), timeout_s=LONGEST_S)


def library(name: str) -> Side:
    """Return the side of another library, which gets the same arms and poses as ours."""

    def side(short: bool) -> Figures:
        python, length = peers.python("poses"), ["short"] if short else []
        with tempfile.TemporaryDirectory() as folder:
            file = str(Path(folder) / "goals.json")
            beside("benchmarks.sides.poses", "goals", file, *length)
            return beside("benchmarks.sides.poses_peers", name, file, python=python, timeout_s=LONGEST_S)

    return side


QUESTION = Question(
    name="poses",
    title="How long does a plan to a pose take, and how exact is it?",
    sides={"ours": ours, **{name: library(name) for name in LIBRARIES}},
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
    limit="""All times are processor time, so that other programs on the computer do not count. `found`, `p50`,
`p95`, `off` and `turned` are of 200 random poses that the arm reaches without touching itself, each planned
from the arm's home position with `linear=False`. `off` and `turned` are the largest distance and turn between a
requested and a planned pose. The poses of so101 are poses of its five joints. `bent` is the largest distance of
a planned setpoint from a straight line, of 40 lines of 10 cm. `refused` is the share of 40 poses outside the
reach that are refused. Most of the time is spent in numpy: one step of a search takes 60 to 100 µs, and most
searches end after 10 steps. The longest plans are those whose first starts lead to no solution.

The other libraries got the same arms, poses, start and tolerances (`benchmarks/sides/poses_peers.py`). None of
them starts anew by itself, so our program starts them at random positions until a pose is found: for pinocchio
its documented loop of damped least squares, for mink a frame task with the limits of the joints (daqp), for
ikpy its least squares over the whole orientation (30 poses of each arm, since it is slow). They only solve: our
time also includes the check of the arm's contacts at the pose and on the way, and which whole turns of a joint
are nearest. Their figures are of these loops, and a program that uses them in another way may be faster. franky
is not compared, since it moves only a connected Franka.""",
    rounds=3,
)

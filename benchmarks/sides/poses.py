"""Measure plans of motions to a pose: ``python -m benchmarks.sides.poses ours [short]``. Nothing moves.

``python -m benchmarks.sides.poses goals FILE [short]`` writes the arms and the poses, for other libraries.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.house import Figures
from benchmarks.poses import ROBOTS
from strands_actors.caller.poses.arm import Arm, turn_between
from strands_actors.caller.poses.curve import along
from strands_actors.caller.poses.plans import PosePlan, plan_pose
from strands_actors.caller.poses.request import PoseRequest, read_request
from strands_actors.caller.poses.timing import limits_of
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import WIRES
from strands_actors.drivers.common.kinematics.urdf import urdf_of
from strands_actors.kernel.messages import Refused

from .common import answer

POSES, LINES, FAR = 200, 40, 40
LINE_M, FAR_M = 0.1, 3.0
SETPOINTS = 200
"""Setpoints of a line whose distance from it is measured."""


def driver_of(robot: str) -> Driver:
    for path in WIRES.values():
        driver_class: type[Driver] = load(path)
        if robot in driver_class.SUPPORTED_ROBOTS:
            return driver_class(robot, "", driver_class.resolve(robot, {}))
    raise ValueError(f"no driver supports {robot}. Name a robot of this package")


def request_of(**pose: Any) -> PoseRequest:
    request = read_request(**pose)
    assert isinstance(request, PoseRequest), request
    return request


def free_poses(arm: Arm, count: int) -> list[Any]:
    """Return joint positions in which the arm does not touch itself."""
    generator, (low, high) = np.random.default_rng(7), arm.searched()
    rows = (generator.uniform(low, high) for _ in range(100 * count))
    free = (rad for rad in rows if arm.touch(rad) is None)
    return [next(free) for _ in range(count)]


def goals_of(robot: str, short: bool) -> dict[str, Any]:
    """Return the arm as URDF and MJCF with a link ``tool``, and the poses, for a library without this package."""
    driver = driver_of(robot)
    model = driver.arm_model({})
    assert model is not None, robot
    arm = Arm(model, *limits_of(driver, model))
    low, high = arm.searched()
    limits = {joint: f"{least},{most}" for joint, least, most in zip(model.joints, low, high, strict=True)}
    rows, parents = [], {}
    for line in str(model.table["model_rows"]).splitlines():
        if line.strip():
            body, parent, joint, axis, xyz, turn, _, effort, velocity, kg, com, geom = line.split()
            own = joint if joint in limits else "-"
            row = (body, parent, own, axis, xyz, turn, limits.get(own, "-"), effort, velocity, kg, com, geom)
            rows.append(" ".join(row))
            parents[body] = parent, own
    place, quat = (",".join(map(str, values)) for values in (model.tool_xyz, model.tool_quat))
    rows.append(f"tool {model.link} - - {place} q:{quat} - - - .01 - -")
    path, link = ["tool", "tool_mount", model.link], model.link
    while link in parents:
        parent, joint = parents[link]
        path += [joint if joint != "-" else f"{link}_mount", parent]
        link = parent
    spec = load(model.builder)({**model.table, "model_rows": "\n".join(rows)})
    spec.compile()
    poses = [arm.pose(rad) for rad in free_poses(arm, POSES // 10 if short else POSES)]
    return {
        "urdf": urdf_of(robot, "\n".join(rows)),
        "mjcf": spec.to_xml(),
        "path": path[::-1],
        "low": low.tolist(),
        "high": high.tolist(),
        "home": arm.home.tolist(),
        "goals": [{"xyz": pose.xyz.tolist(), "quat": pose.quat.tolist()} for pose in poses],
    }


def figures_of(robot: str, short: bool) -> Figures:
    driver = driver_of(robot)
    model = driver.arm_model({})
    assert model is not None, robot
    arm = Arm(model, *limits_of(driver, model))
    goals = free_poses(arm, POSES // 10 if short else POSES)
    took_ms, off_mm, turned_deg = [], [], []
    for rad in goals:
        pose = arm.pose(rad)
        request = request_of(xyz=pose.xyz, quat=pose.quat, linear=False)
        began_s = time.process_time()
        plan = plan_pose(arm, request, arm.home)
        took_ms.append((time.process_time() - began_s) * 1e3)
        if isinstance(plan, PosePlan):
            off_mm.append(float(np.linalg.norm(plan.goal.xyz - pose.xyz)) * 1e3)
            turned_deg.append(float(np.degrees(np.linalg.norm(turn_between(plan.goal.quat, pose.quat)))))
    return {
        f"{robot}_found_pct": 100 * len(off_mm) / len(goals),
        f"{robot}_p50_ms": float(np.percentile(took_ms, 50)),
        f"{robot}_p95_ms": float(np.percentile(took_ms, 95)),
        f"{robot}_off_mm": max(off_mm),
        f"{robot}_turned_deg": max(turned_deg),
        f"{robot}_bent_mm": bent_mm(arm, goals),
        f"{robot}_refused_pct": refused_pct(arm),
    }


def bent_mm(arm: Arm, starts: list[Any]) -> float:
    """Return the largest distance of a setpoint from its straight line, over the lines that can be followed."""
    generator, worst = np.random.default_rng(8), 0.0
    for rad in starts[:LINES]:
        here, way = arm.pose(rad), generator.normal(size=3)
        way *= LINE_M / np.linalg.norm(way)
        plan = plan_pose(arm, request_of(xyz=here.xyz + way), rad)
        if isinstance(plan, PosePlan):
            for number in range(SETPOINTS + 1):
                off = arm.pose(along(plan.waypoints, number / SETPOINTS)).xyz - here.xyz
                worst = max(worst, float(np.linalg.norm(off - way * (off @ way) / (way @ way))))
    return worst * 1e3


def refused_pct(arm: Arm) -> float:
    generator = np.random.default_rng(9)
    ways = generator.normal(size=(FAR, 3))
    goals = [way / np.linalg.norm(way) * FAR_M for way in ways]
    plans = [plan_pose(arm, request_of(xyz=goal), arm.home) for goal in goals]
    return 100 * sum(isinstance(plan, Refused) for plan in plans) / FAR


def ours(short: bool) -> Figures:
    figures: Figures = {}
    for robot in ROBOTS:
        figures |= figures_of(robot, short)
    return figures


if __name__ == "__main__" and sys.argv[1:2] == ["goals"]:
    arms = {robot: goals_of(robot, "short" in sys.argv) for robot in ROBOTS}
    Path(sys.argv[2]).write_text(json.dumps(arms))
    answer({"goals": lambda short: {"arms": len(arms)}})
elif __name__ == "__main__":
    answer({"ours": ours})

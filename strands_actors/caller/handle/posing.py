"""Poses of a robot's tool: ``get_pose``, and ``move_to`` with a pose.

The joint positions are computed in a thread of this process, and never in a process of the robot. The motion itself
is a stream of setpoints, as of ``move_to`` with joint targets.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import trio

from strands_actors.contract.arm_model import ArmModel
from strands_actors.contract.driver import Driver
from strands_actors.contract.tool_verbs import POSE_INPUTS
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from ..poses import refusals
from ..poses.request import PoseRequest, read_request
from ..session.motions import MOVE_TO, Motion, RobotReading
from ..session.refusals import no_reading
from ..session.tree import RobotTree
from . import envelopes as answers
from . import moving
from .envelopes import Answer

if TYPE_CHECKING:
    from ..poses.arm import Arm
    from ..poses.timing import TimedPlan

GET_POSE, POSE = "get_pose", "pose"
SETTLE_S, LOOK_S, STILL_RAD = 0.5, 0.05, 2e-4
"""The pose at the end of a motion is read when no joint has moved by ``STILL_RAD`` in ``LOOK_S``, and after
``SETTLE_S`` at the latest."""

ATTEMPTS = 3
"""A motion is planned so often if the arm still moves."""

T = TypeVar("T")


def given(**arguments: Any) -> dict[str, Any]:
    """Return the arguments that are not None."""
    return {name: value for name, value in arguments.items() if value is not None}


async def get_pose(tree: RobotTree) -> Answer:
    """Return the pose of the tool. The keys are those of ``RealRobot.get_pose``."""
    observation = await tree.observe()
    if isinstance(observation, Refused):
        return answers.refused(observation.about(GET_POSE))
    pose = await _computed(_pose_of, tree.driver, observation)
    if isinstance(pose, Refused):
        return answers.refused(pose.about(GET_POSE))
    return answers.success({"robot": tree.robot, **pose, **_reported(tree.driver, observation, pose["xyz"])})


def _reported(driver: Driver, observation: Observation, xyz: Sequence[float]) -> dict[str, Any]:
    """Return the position of the tool that the controller of the robot reports, and its distance from ours."""
    of_base = (each for each in driver.SENSORS if each.topic == POSE and each.words.get("frame") == "base")
    sensor = next(of_base, None)
    row = () if sensor is None else observation.sensors.get(sensor.fields["xyz"], ())[:3]
    if len(row) < 3 or not all(map(math.isfinite, row)):
        return {}
    return {"reported_xyz": [round(value, 6) for value in row], "apart_m": round(math.dist(row, xyz), 6)}


async def move_to(
    tree: RobotTree, targets: Mapping[str, Any] | None, seconds: float | None, wait: bool, pose: Mapping[str, Any]
) -> Answer:
    """Move joints to their targets, or the tool to a pose.

    Args:
        tree: The robot.
        targets: Target by joint; None for a motion to a pose.
        seconds: Duration of a motion to targets; None for the default.
        wait: True returns at the end of the motion, False at once.
        pose: The further arguments of ``RealRobot.move_to`` that were given, by name.
    """
    if not any(name in pose for name in POSE_INPUTS):
        if pose:
            return answers.refused(refusals.pose_arguments(next(iter(pose))))
        if targets is None:
            return answers.refused(refusals.no_pose())
        return await moving.move_to(tree, targets, moving.DEFAULT_S if seconds is None else seconds, wait)
    if targets is not None:
        return answers.refused(refusals.targets_and_pose())
    if seconds is not None:
        return answers.refused(refusals.seconds_of_pose())
    request = read_request(**pose)
    return answers.refused(request) if isinstance(request, Refused) else await move_to_pose(tree, request, wait)


async def move_to_pose(tree: RobotTree, request: PoseRequest, wait: bool) -> Answer:
    """Move the tool to a pose, and return at the end of the motion if ``wait`` is true.

    If the arm still moved from an earlier motion while this one was planned, it is planned again at rest.
    """
    attempts = 0
    while True:
        timed = await _planned(tree, request)
        if isinstance(timed, Refused):
            return answers.refused(timed.about(MOVE_TO))
        motion = await tree.rollouts.move(MOVE_TO, _starts(tree.driver, timed))
        attempts += 1
        if not isinstance(motion, Refused) or motion.code != Code.MOVED or attempts >= ATTEMPTS:
            break
        await _settled(tree)
    answer = await moving.to_its_end(tree, motion, wait, pose=timed.plan.goal.as_json())
    return await _with_measured_pose(tree, answer) if wait and answer["status"] == "success" else answer


async def _planned(tree: RobotTree, request: PoseRequest) -> TimedPlan | Refused:
    """Return the motion to a pose from the newest reading, or a refusal."""
    status = await tree.status()
    if status is not None and status.no_motion is not None:
        return status.no_motion
    if status is None or status.observation is None or not status.target:
        return await _reason_unread(tree)
    reading = RobotReading(status.observation, status.target, status.observation.t_ns)
    return await _computed(_timed, tree.driver, request, reading, _period_s(tree.driver))


def _starts(driver: Driver, timed: TimedPlan) -> Callable[[RobotReading], Motion | Refused]:
    from ..poses.timing import motion_of

    return lambda reading: motion_of(driver, timed, reading, _period_s(driver))


def _period_s(driver: Driver) -> float:
    return 1.0 / driver.timing.control_hz


async def _with_measured_pose(tree: RobotTree, answer: Answer) -> Answer:
    """Return the answer of a motion with the positions and the pose of the arm at rest."""
    observation = await _settled(tree)
    if isinstance(observation, Refused):
        return answer
    reached = await _computed(_pose_of, tree.driver, observation)
    if isinstance(reached, Refused):
        return answer
    reply, row = answer["content"][0]["json"], answers.positions(tree.driver, observation)
    position = {key: row[key] for key in reply.get("position", {})}
    return answers.success({**reply, "position": position, "measured_pose": reached})


async def _settled(tree: RobotTree) -> Observation | Refused:
    """Return a reading of the arm at rest. A real arm follows its setpoints with a delay."""
    before: tuple[float, ...] = ()
    units = [abs(scale) for _, scale in tree.driver.model_units()]
    with trio.move_on_after(SETTLE_S):
        while True:
            observation = await tree.observe()
            if isinstance(observation, Refused):
                return observation
            moved = zip(observation.position, before, units, strict=False)
            if before and all(abs(now - then) < STILL_RAD * unit for now, then, unit in moved):
                return observation
            before = observation.position
            await trio.sleep(LOOK_S)
    return await tree.observe()


async def _reason_unread(tree: RobotTree) -> Refused:
    """Return why a motion cannot begin, for a robot that is not armed or was not read."""
    observation = await tree.observe()
    if isinstance(observation, Refused):
        return observation.about(MOVE_TO)
    return no_reading(MOVE_TO)


async def _computed(function: Callable[..., T], *arguments: Any) -> T:
    """Run a function that computes for some milliseconds in a thread, so that heartbeats are sent meanwhile."""
    return await trio.to_thread.run_sync(functools.partial(function, *arguments))


def _pose_of(driver: Driver, observation: Observation) -> dict[str, Any] | Refused:
    arm = _arm_of(driver, observation)
    if isinstance(arm, Refused):
        return arm
    from ..poses.timing import units_of

    return arm.pose(units_of(driver, arm.names).rad(observation.position)).as_json()


def _timed(driver: Driver, request: PoseRequest, reading: RobotReading, period_s: float) -> TimedPlan | Refused:
    arm = _arm_of(driver, reading.observation, request)
    if isinstance(arm, Refused):
        return arm
    from ..poses.plans import plan_pose
    from ..poses.timing import time_plan, units_of

    plan = plan_pose(arm, request, units_of(driver, arm.names).rad(reading.observation.position))
    if isinstance(plan, Refused):
        return plan
    return time_plan(driver, plan, request.speed_m_s, reading, period_s)


def _arm_of(driver: Driver, observation: Observation, request: PoseRequest | None = None) -> Arm | Refused:
    """Return the arm as it was measured, or a refusal."""
    model = driver.arm_model(observation.sensors)
    if model is None:
        return refusals.no_arm("", driver.robot)
    measured = dict(zip(driver.axes, observation.position, strict=False))
    for joint in model.joints:
        if not math.isfinite(measured[joint]):
            return refusals.unknown_joint_position("", joint)
    # MuJoCo and numpy are imported only here, since most programs need no poses.
    from ..poses.arm import Arm
    from ..poses.timing import limits_of

    low, high = limits_of(driver, model)
    keep_out = () if request is None else request.keep_out
    return Arm(model, low, high, _others(driver, model, measured), keep_out)


def _others(driver: Driver, model: ArmModel, measured: dict[str, float]) -> dict[str, float]:
    """Return the positions of the other joints in rad, such as that of a gripper."""
    units = dict(zip(driver.axes, driver.model_units(), strict=True))
    return {
        joint: (value - units[joint][0]) / units[joint][1]
        for joint, value in measured.items()
        if joint not in model.joints and math.isfinite(value)
    }


__all__ = ["get_pose", "given", "move_to"]

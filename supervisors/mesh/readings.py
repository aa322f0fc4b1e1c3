"""Build the value of the topic ``state``, and the answers to queries that need no lease. Pure, except for the time
stamp and the age of the last stop."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Mapping
from typing import Any

import msgspec

from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.contract.driver import Driver
from strands_actors.contract.tool_spec import tool_spec
from strands_actors.kernel.clock import NS
from strands_actors.supervisors.gate.failsafe import WRITABLE
from strands_actors.supervisors.gate.messages import Status, StopReport
from strands_actors.supervisors.root.messages import UNREACHABLE, TaskStatus

TELEOP: Mapping[str, Any] = {"inputs": [], "publishers": {}, "receivers": {}}
"""No leader arm writes to this robot over the mesh."""


def task_of(task: TaskStatus, status: Status | None) -> TaskStatus:
    """Return the status of the robot's task.

    Args:
        task: Status of a named policy, which the root has started.
        status: Status from the gate. If a script runs a policy object itself, only the gate knows its rollout.
    """
    rollout = None if status is None else status.rollout
    if task.running or rollout is None:
        return task
    return TaskStatus(True, rollout.steps, rollout.elapsed_s, instruction=rollout.instruction)


def state_of(robot: str, driver: Driver, task: TaskStatus, status: Status | None) -> dict[str, Any]:
    """Return the value of the topic ``state``. For ``task`` see ``task_of``."""
    task = task_of(task, status)
    state: dict[str, Any] = {
        "peer_id": robot,
        "t": time.time(),
        "degraded": status is None or status.mode not in WRITABLE,
        "state": mode_of(status),
        "epoch": 0 if status is None else status.epoch,
        "task": {
            "status": "running" if task.running else "idle",
            "instruction": task.instruction,
            "steps": task.steps,
        },
        "unit": driver.unit,
        "joints": {},
    }
    if status is not None:
        state |= {
            "cause": status.cause,
            "setpoints": status.setpoints,
            "refused": dict(status.refused),
            "last_refusal": status.last_refusal,
            "last_stop": None if status.last_stop is None else stop_json(status.last_stop),
        }
        if status.last_stop is not None and status.last_stop.at_ns:
            state["last_stop_ago_s"] = (time.monotonic_ns() - status.last_stop.at_ns) / NS
    observation = None if status is None else status.observation
    if status is not None and observation is not None:
        state["joints"] = driver.as_telemetry(observation)
        state["age_s"] = status.age_s
        if status.mode in WRITABLE and status.target:
            state["targets"] = driver.as_json(status.target)
        if observation.velocity:
            state["velocities"] = driver.as_json(observation.velocity)
        if driver.TORQUES in observation.sensors:
            state["efforts"] = dict(zip(driver.axes, observation.sensors[driver.TORQUES], strict=False))
        if "sim_time_s" in observation.sensors:
            state["sim_time"] = observation.sensors["sim_time_s"][0]
    return state


def stop_json(report: StopReport) -> dict[str, Any]:
    """Return the result of the last stop in brief. ``epoch`` distinguishes one stop from the next."""
    return {
        "epoch": report.epoch,
        "reason": report.reason,
        "safe_state": report.safe_state,
        "confirmed": report.confirmed,
        "unconfirmed": report.unconfirmed,
        "path": report.path,
        "took_ms": round(report.took_ms, 2),
        "written_ms": round(report.written_ms, 2),
    }


def mode_of(status: Status | None) -> str:
    return UNREACHABLE if status is None else status.mode


def features(driver: Driver) -> dict[str, Any]:
    """Return the keys of actions and observations, with unit and range."""
    limits = {axis.key: [axis.low, axis.high] for axis in driver.table}
    return {
        "action_features": dict.fromkeys(driver.axes, "float"),
        "observation_features": dict.fromkeys(driver.axes, "float"),
        "velocities": [axis.key for axis in driver.table if axis.mode is AxisMode.VELOCITY],
        "limits": limits,
        "axes": {axis.key: axis_json(axis) for axis in driver.table},
        "unit": driver.unit,
        "control_hz": driver.timing.control_hz,
        "services": sorted(driver.SERVICES),
    }


def axis_json(axis: Axis) -> dict[str, Any]:
    """Return an axis as a mapping for JSON, in which a limit that does not exist is None."""
    fields = {"unit": axis.unit, "low": axis.low, "high": axis.high, "speed": axis.speed, "rest": axis.rest}
    finite = {name: None if value in (math.inf, -math.inf) else value for name, value in fields.items()}
    return {**finite, "mode": str(axis.mode), "optional": axis.optional}


def tool_of(robot: str, driver: Driver) -> dict[str, Any]:
    """Return the spec of the tool for agents, and a hash that changes when the spec changes."""
    spec = tool_spec(robot, driver)
    encoded = msgspec.json.encode(spec, order="sorted")
    return {"tool_name": robot, "tool_spec_hash": hashlib.sha256(encoded).hexdigest(), "spec": spec}

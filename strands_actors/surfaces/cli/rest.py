"""``rest``: teach the pose to which an arm is lowered before its torque is switched off."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from strands_actors.caller.resolve.wanted import TOOL_NAMES, is_tool_name
from strands_actors.contract.loading import load
from strands_actors.contract.shown import shown
from strands_actors.kernel.clock import MonotonicClock

from .calibrate import of_servos, run_for_person
from .errors import Problem
from .person import Terminal

TEACH = "strands_actors.drivers.common.servo.resting:teach"
SAVE = "strands_actors.drivers.common.kit.calibration:save_json"
READ = "strands_actors.drivers.common.servo.resting:read"


def rest(robot: str, port: str | None, robot_id: str | None, teaches: bool, as_json: bool) -> int:
    """Show the rest pose of an arm, or teach it: the user lays the arm down by hand. Return the exit code."""
    name, driver_class = of_servos(robot, "rest")
    if not driver_class.is_lowered(name):
        raise Problem(f"rest: {name} is not lowered: its torque is switched off at once")
    own_id = name if robot_id is None else robot_id
    if not is_tool_name(own_id):
        raise Problem(f"rest: --id is {shown(own_id)}, and {name} cannot be called so. Use {TOOL_NAMES}")
    path = driver_class.rest_file(name, own_id)
    if teaches:
        if port is None:
            raise Problem("rest: --port is missing. Give the serial port of the arm")
        pose = _teach(driver_class, name, port, own_id, as_json)
        try:
            load(SAVE)(path, pose)
        except OSError as failure:
            raise Problem(
                f"rest: {path} could not be written ({failure.strerror}). Make its folder writable, or name "
                "another by HF_LEROBOT_CALIBRATION"
            ) from failure
    else:
        try:
            pose = load(READ)(name, path, [joint["key"] for joint in driver_class.TABLES.robots[name]["joints"]])
        except ValueError as refusal:
            raise Problem(f"rest: {refusal}") from refusal
    if as_json:
        print(json.dumps({"robot": name, "file": str(path), "rest": pose}))
    else:
        print(", ".join(f"{joint} {value:.1f}" for joint, value in pose.items()))
        print(f"rest pose of {own_id}: {path}")
    return 0


def _teach(driver_class: Any, name: str, port: str, own_id: str, as_json: bool) -> Mapping[str, float]:
    try:
        # An existing rest pose may be wrong, so it is not read.
        options = driver_class.resolve(name, {"tool_name": own_id, "on_exit": "limp"})
    except ValueError as refusal:
        raise Problem(f"rest: {refusal}") from refusal
    driver = driver_class(name, port, options)
    setup = load(driver_class.SETUP)(driver.config, MonotonicClock())
    person = Terminal(quiet=as_json)

    async def run() -> Any:
        try:
            return await load(TEACH)(setup, person)
        finally:
            setup.close()

    pose: Mapping[str, float] = run_for_person(run, "rest")
    return pose

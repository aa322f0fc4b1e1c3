"""``calibrate``, ``setup-motors`` and ``ports``: the commands for a newly built robot."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import trio

from strands_actors.caller.resolve.wanted import TOOL_NAMES, is_tool_name
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.contract.shown import closest, shown
from strands_actors.contract.wire import WireDown
from strands_actors.drivers import (
    canonical_name,
    get_native_driver_class,
    leader_name,
    list_driver_coverage,
    list_leaders,
    list_native_drivers,
)
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.surfaces.serial_ports import serial_ports

from .dialogue import Dialogue
from .errors import Problem
from .person import Terminal

CALIBRATE = "strands_actors.drivers.common.servo.calibrating:calibrate"
PLAN = "strands_actors.drivers.common.servo.calibrating:Plan"
TAKE_FILE = "strands_actors.drivers.common.servo.recalibrating:take_file"
PUT_BACK = "strands_actors.drivers.common.servo.recalibrating:put_back"
KEEP = "strands_actors.drivers.common.kit.calibration_kept:keep"
LOAD_KEPT = "strands_actors.drivers.common.kit.calibration_kept:load_kept"
SAVE_TEXT = "strands_actors.drivers.common.kit.calibration:save_text"
FIRMWARE = "firmware"
PREPARE = "strands_actors.drivers.common.kit.calibration:prepare"
SAVE = "strands_actors.drivers.common.kit.calibration:save"


def calibrate(
    robot: str,
    port: str,
    robot_id: str | None,
    as_json: bool,
    accept: Sequence[str] = (),
    source: Path | None = None,
    undo: bool = False,
    dialogue: bool = False,
) -> int:
    """Ask the user to move each joint through its range, or take the calibration from elsewhere. Write it into the
    servos and into LeRobot's calibration file. Return the exit code.

    Args:
        robot: The robot or leader arm.
        port: Its serial port.
        robot_id: Its id; None for its name.
        as_json: Print the result as JSON.
        accept: Joints that may have another range than the robot's table, and ``firmware``.
        source: A calibration file to write, in place of moving the joints.
        undo: Write the values that the servos had before the last calibration.
        dialogue: Ask by lines of JSON.
    """
    name, driver_class = of_servos(robot, "calibrate")
    setup = _setup(driver_class, name, port)
    path = _file(driver_class, name, name if robot_id is None else robot_id)
    person = person_of(as_json, dialogue)
    plan = _plan(driver_class, name, accept)
    if undo and source is not None:
        raise Problem("calibrate: --undo and --from were both given. Leave one of them out")
    motor_ids = {axis.key: axis.id for axis in setup.axes}

    def keep(registers: Any) -> None:
        try:
            load(KEEP)(path, name, registers)
        except (OSError, ValueError) as failure:
            raise ValueError(f"the present values could not be kept ({failure}). Nothing was changed") from failure

    async def run() -> Any:
        try:
            if undo:
                kept = load(LOAD_KEPT)(path, name, motor_ids, setup.REGISTERS)
                return await load(PUT_BACK)(setup, kept.registers, keep), kept.file
            if source is not None:
                return await load(TAKE_FILE)(setup, person, plan, source, keep), None
            return await load(CALIBRATE)(setup, person, plan, keep), None
        finally:
            setup.close()

    proposal, text = run_for_person(run, "calibrate")
    _save(path, proposal.motors, text, undo)
    if as_json:
        ranges = {key: [motor.range_min, motor.range_max] for key, motor in proposal.motors.items()}
        findings = [msgspec.to_builtins(finding) for finding in proposal.findings]
        print(json.dumps({"robot": name, "file": str(path), "ranges": ranges, "findings": findings}))
    elif undo:
        print(f"put back. --undo once more returns to the values that were there. File: {path}")
    else:
        print(f"calibrated. LeRobot's file of it: {path}. --undo puts the old values back")
    return 0


def _plan(driver_class: Any, name: str, accept: Sequence[str]) -> Any:
    table = driver_class.TABLES.robots[name]
    ranges = {joint["key"]: tuple(joint["range_rad"]) for joint in table["joints"]}
    if wrong := [word for word in accept if word not in ranges and word != FIRMWARE]:
        raise Problem(f"calibrate: --accept is {shown(wrong[0])}. Use {FIRMWARE}, {', '.join(ranges)}")
    return load(PLAN)(
        ranges, table.get("whole_turn", ()), table.get("inverted", ()), driver_class.MAX_OFFSET, tuple(accept)
    )


def _save(path: Path, motors: Any, text: str | None, undo: bool) -> None:
    """Write the calibration file. After ``--undo`` it is the earlier one, or there is none."""
    try:
        if not undo:
            load(SAVE)(path, motors)
        elif text is None:
            path.unlink(missing_ok=True)
        else:
            load(SAVE_TEXT)(path, text)
    except OSError as failure:
        raise Problem(
            f"calibrate: the servos are calibrated, and {path} could not be written ({failure.strerror}). "
            "Make room for it, then calibrate again"
        ) from failure


def _file(driver_class: Any, name: str, robot_id: str) -> Path:
    """Return the path of a robot's calibration file. Raise ``Problem`` if the file cannot be written."""
    if leader_name(name) is None and not is_tool_name(robot_id):
        raise Problem(f"calibrate: --id is {shown(robot_id)}, and {name} cannot be called so. Use {TOOL_NAMES}")
    try:
        path: Path = driver_class.calibration_file(name, robot_id)
        load(PREPARE)(path)
    except ValueError as refusal:
        raise Problem(f"calibrate: --id: {refusal}") from refusal
    except OSError as failure:
        raise Problem(
            f"calibrate: {path} cannot be written ({failure.strerror}). Make its folder writable, or name "
            "another by HF_LEROBOT_CALIBRATION"
        ) from failure
    return path


def person_of(as_json: bool, dialogue: bool) -> Terminal | Dialogue:
    """Return the one to ask: the user at the terminal, or a program."""
    return Dialogue() if dialogue else Terminal(quiet=as_json)


def setup_motors(robot: str, port: str, joints: Sequence[str], as_json: bool, dialogue: bool = False) -> int:
    """Write an id into each servo. The user connects one servo at a time, beginning with the last joint.
    Return the exit code."""
    name, driver_class = of_servos(robot, "setup-motors")
    setup = _setup(driver_class, name, port)
    axes = {axis.key: axis for axis in setup.axes}
    if wrong := [joint for joint in joints if joint not in axes]:
        raise Problem(f"setup-motors: {name} has no {', '.join(wrong)}. It has {', '.join(axes)}")
    chosen = [axis for key, axis in reversed(axes.items()) if not joints or key in joints]
    person = person_of(as_json, dialogue)
    servos = []

    async def run() -> None:
        try:
            for axis in chosen:
                await person.ready(f"connect the servo of {axis.key}, and no other")
                servos_seen = await setup.seek()
                if len(servos_seen) != 1:
                    listed = ", ".join(f"id {each.id} at {each.baud} baud" for each in servos_seen) or "none"
                    raise WireDown(f"exactly one servo must be connected, but found {listed}. Connect one servo")
                await setup.adopt(servos_seen[0], axis)
                servos.append({"joint": axis.key, "was": servos_seen[0].id, "id": axis.id})
                person.say(f"{axis.key}: id {servos_seen[0].id} -> {axis.id}")
        finally:
            setup.close()

    run_for_person(run, "setup-motors")
    if as_json:
        print(json.dumps({"robot": name, "servos": servos}))
    return 0


def ports(also: Sequence[str], as_json: bool) -> int:
    """Ask the user to unplug a serial adapter, find out which port has vanished, and print it. Return the exit
    code."""
    person = Terminal(quiet=as_json)
    before = serial_ports(also)
    if not as_json:
        for path, about in before.items():
            print(f"{path}  {about}".rstrip())
    if not before:
        raise Problem("ports: there is no serial adapter. Plug one in")

    async def run() -> dict[str, str]:
        await person.ready("unplug the adapter of the robot")
        return serial_ports(also)

    after = run_for_person(run, "ports")
    unplugged = {path: about for path, about in before.items() if path not in after}
    if len(unplugged) != 1:
        unplugged_names = ", ".join(unplugged) or "no adapter"
        raise Problem(
            f"ports: {unplugged_names} was unplugged. Unplug only the adapter of the robot, and try again"
        )
    (path, about), *_ = unplugged.items()
    if as_json:
        print(json.dumps({"port": path, "about": about}))
    else:
        print(f"it is {path}. Plug it in again")
        if about:
            print(about)
    return 0


def of_servos(robot: str, verb: str) -> tuple[str, Any]:
    """Return the name and the driver class of a robot or leader with Feetech or Dynamixel servos. Raise
    ``Problem`` for other robots."""
    leader = leader_name(robot)
    driver_class = get_native_driver_class(robot) if leader is None else list_leaders()[leader]
    if driver_class is None and canonical_name(robot) not in list_driver_coverage():
        close = closest(robot, [*list_native_drivers(), *list_leaders()])
        hint = f" ({close[0]}?)" if close else ""
        raise Problem(f"{verb}: {shown(robot)} is not known{hint}. `strands-actors list` has them all")
    if driver_class is None or not issubclass(driver_class, Driver) or not hasattr(driver_class, "SETUP"):
        raise Problem(f"{verb}: {robot} is no robot of Feetech or Dynamixel servos: its maker calibrates it")
    return leader or canonical_name(robot), driver_class


def _setup(driver_class: Any, name: str, port: str) -> Any:
    # Do not read an existing calibration file. It may be wrong, which may be why the user calibrates again.
    driver = driver_class(name, port, driver_class.resolve(name, {}))
    return load(driver_class.SETUP)(driver.config, MonotonicClock())


def run_for_person(work: Callable[[], Any], verb: str) -> Any:
    try:
        return trio.run(work)
    except (WireDown, ValueError) as failure:
        raise Problem(f"{verb}: {failure}") from failure

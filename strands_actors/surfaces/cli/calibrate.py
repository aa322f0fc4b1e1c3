"""``calibrate``, ``setup-motors`` and ``ports``: the commands for a newly built robot."""

from __future__ import annotations

import json
import os
import select
import sys
from collections.abc import Callable, Sequence
from glob import glob
from pathlib import Path
from typing import Any

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

from .errors import Problem

CALIBRATE = "strands_actors.drivers.common.servo.calibrating:calibrate"
PREPARE = "strands_actors.drivers.common.kit.calibration:prepare"
SAVE = "strands_actors.drivers.common.kit.calibration:save"
TURN_S = 0.05
BY_ID = "/dev/serial/by-id/*"


def calibrate(robot: str, port: str, robot_id: str | None, as_json: bool) -> int:
    """Ask the user to move each joint to its middle and through its range. Write the result in LeRobot's
    calibration file. Return the exit code."""
    name, driver_class = of_servos(robot, "calibrate")
    setup = _setup(driver_class, name, port)
    table = driver_class.TABLES.robots[name]
    person = Terminal(quiet=as_json)
    path = _file(driver_class, name, name if robot_id is None else robot_id)

    async def run() -> Any:
        try:
            return await load(CALIBRATE)(
                setup, person, table.get("whole_turn", ()), table.get("inverted", ()), driver_class.MAX_OFFSET
            )
        finally:
            setup.close()

    motors = run_for_person(run, "calibrate")
    try:
        load(SAVE)(path, motors)
    except OSError as failure:
        raise Problem(
            f"calibrate: the servos are calibrated, and {path} could not be written ({failure.strerror}). "
            "Make room for it, then calibrate again"
        ) from failure
    if as_json:
        ranges = {key: [motor.range_min, motor.range_max] for key, motor in motors.items()}
        print(json.dumps({"robot": name, "file": str(path), "ranges": ranges}))
    else:
        print(f"calibrated. LeRobot's file of it: {path}")
    return 0


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


def setup_motors(robot: str, port: str, joints: Sequence[str], as_json: bool) -> int:
    """Write an id into each servo. The user connects one servo at a time, beginning with the last joint.
    Return the exit code."""
    name, driver_class = of_servos(robot, "setup-motors")
    setup = _setup(driver_class, name, port)
    axes = {axis.key: axis for axis in setup.axes}
    if wrong := [joint for joint in joints if joint not in axes]:
        raise Problem(f"setup-motors: {name} has no {', '.join(wrong)}. It has {', '.join(axes)}")
    chosen = [axis for key, axis in reversed(axes.items()) if not joints or key in joints]
    person = Terminal(quiet=as_json)
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


def serial_ports(also: Sequence[str] = ()) -> dict[str, str]:
    """Return the serial devices by path, each with a text: USB ids, product and permanent path.

    Args:
        also: Further device paths, which may contain wildcards.
    """
    from serial.tools import list_ports

    stay = {os.path.realpath(link): link for link in glob(BY_ID)}
    ports = {}
    for port in sorted(list_ports.comports()):
        usb_id = f"{port.vid:04X}:{port.pid:04X}" if port.vid is not None and port.pid is not None else ""
        ports[port.device] = " ".join(
            part for part in (usb_id, port.product or "", stay.get(port.device, "")) if part
        )
    return ports | {path: "" for pattern in also for path in sorted(glob(pattern))}


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


class Terminal:
    """Prints instructions for the user, and waits until the user presses Enter."""

    def __init__(self, quiet: bool) -> None:
        self._lines = 0
        self._quiet = quiet
        self._redraws = sys.stderr.isatty() and not quiet

    def say(self, text: str) -> None:
        if not self._quiet:
            print(text, file=sys.stderr, flush=True)

    async def ready(self, text: str) -> None:
        """Print an instruction, and wait for Enter."""
        self.say(f"{text}, then press Enter")
        self._lines = 0
        while True:
            readable, _, _ = select.select([sys.stdin], [], [], 0)
            if readable:
                if not sys.stdin.readline():
                    raise ValueError(
                        "standard input has ended, so Enter cannot be pressed. Run this command in a terminal"
                    )
                return
            await trio.sleep(TURN_S)

    def show(self, ranges: Any) -> None:
        """Print the range of each joint over the previous output. Do nothing if stderr is not a terminal."""
        if not self._redraws:
            return
        up = f"\x1b[{self._lines}A" if self._lines else ""
        rows = [
            f"\x1b[K{key:16} {ranges.low[key]:5} {ranges.now[key]:5} {ranges.high[key]:5}" for key in ranges.now
        ]
        print(up + "\n".join([f"\x1b[K{'joint':16} {'low':>5} {'now':>5} {'high':>5}", *rows]), file=sys.stderr)
        self._lines = len(rows) + 1

"""``teleop``: teleoperate a robot by a leader arm, a web page, or the keys of this terminal."""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import sys
import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from strands_actors.caller.handle.envelopes import warn_unless_safe
from strands_actors.caller.handle.real_robot import RealRobot
from strands_actors.caller.processes.run_directory import data_dir
from strands_actors.contract.loading import load
from strands_actors.contract.pose_keys import POSE_KEYS
from strands_actors.teleoperation.actor import CONNECTED, CONNECTING, KEY
from strands_actors.teleoperation.keys import Keys
from strands_actors.teleoperation.teleoperator import KEYBOARD, PAGES, PHONE, Teleoperator

from .errors import Problem
from .one_robot import TWIN, OneRobot

TURN_S = 0.03
SHOW_S = 0.1
ENTER = "\n"
QUIT = ("x", "\x1b")


def teleop(
    follower: OneRobot,
    leader: tuple[str, str | None],
    deadman: str | None,
    relative: bool,
    hz: float,
    max_speed: float | None,
    map_fn: str | None,
    seconds: float | None,
    as_json: bool,
) -> int:
    """Teleoperate a robot until a key is pressed, the duration has passed, or the robot has ended.

    Args:
        follower: The robot that is led.
        leader: The leader in the form of ``leader_of``, and its id.
        deadman: The dead-man switch: ``key``, ``gripper``, or None for the default.
        relative: True: the robot repeats the leader's movements since the operator engaged. False: the robot goes
            to the leader's position.
        hz: Setpoints per second.
        max_speed: Largest speed in degrees per second. Faster setpoints are refused.
        map_fn: ``module:function`` that converts the leader's positions to the robot's. None for no conversion.
        seconds: Duration; None for no limit.
        as_json: Print JSON.

    Returns:
        The exit code: 0 if the user or the duration ended the teleoperation and the leader was connected,
        else 1.
    """
    is_terminal = sys.stdin.isatty()
    try:
        mapped = load(map_fn) if map_fn else None
    except (ImportError, AttributeError) as failure:
        raise Problem(f"teleop: --map {map_fn}: {failure}. Give module:function") from failure
    try:
        led_by = leader_of(*leader, relative)
        arm = follower.make("teleop")
    except (ValueError, TypeError) as refusal:
        raise Problem(f"teleop: {refusal}") from refusal
    if led_by.name == KEYBOARD and not is_terminal:
        raise Problem(
            f"teleop: {led_by.name} needs a terminal, but standard input is not a terminal. Run this in a terminal"
        )
    if led_by.is_arm and deadman is None and is_terminal:
        deadman = KEY
    with led_by, _connected(arm):
        begun = arm.attach_teleop(led_by, hz, mapped, deadman, max_speed, seconds)
        if begun["status"] != "success":
            raise Problem(begun["content"][0]["text"])
        axes = _jogged(arm) if led_by.name == KEYBOARD else ()
        keys = Keys(axes) if is_terminal and (led_by.name == KEYBOARD or deadman == KEY) else None
        if led_by.name in PAGES:
            print(_page(arm, led_by), file=sys.stderr, flush=True)
        status = _run(arm, keys, led_by.is_arm, is_terminal, quiet=as_json)
    if as_json:
        print(json.dumps(status))
    else:
        detail = f" ({status['exit_detail']})" if status["exit_detail"] else ""
        refused = status["teleop"]["refused"]
        print(f"{status['steps']} setpoints, {refused} frames refused; ended: {status['exit_reason']}{detail}")
        if is_lost(status):
            print(f"the leader is not connected: {status['teleop']['leader']}", file=sys.stderr)
    return 0 if status["exit_reason"] in ("stopped", "duration") and not is_lost(status) else 1


def _jogged(arm: RealRobot) -> tuple[str, ...]:
    """Return the names that get keys: the axes of the robot, and the directions of its tool."""
    has_tool = arm.driver.arm_model({}) is not None
    return (*arm.driver.axes, *(POSE_KEYS if has_tool else ()))


def is_lost(status: dict[str, Any]) -> bool:
    """Return True if a status reports that the leader is not connected."""
    return status["teleop"]["leader"] not in (CONNECTED, CONNECTING)


def leader_of(text: str, leader_id: str | None = None, relative: bool = False) -> Teleoperator:
    """Build the leader (the device that the operator moves) from the option ``--from``.

    Args:
        text: ``NAME:PORT``, ``NAME:PORT:ID``, ``NAME:twin``, ``keyboard``, ``module:Class``, ``lerobot:TYPE``.
        leader_id: The id of a leader arm, which is the name of its calibration.
        relative: True: the robot repeats the leader's movements since the operator engaged. False: the robot goes
            to the leader's position.

    Raises:
        ValueError: The leader is not known, or two names of its calibration are given.
        TypeError: The leader does not accept an argument.
    """
    name, _, place = text.partition(":")
    if name in PAGES and place:
        return Teleoperator(name, listen=place, id=leader_id)
    if name == KEYBOARD or not name.endswith("_leader"):
        return Teleoperator(text, relative=relative, id=leader_id)
    if not place:
        raise ValueError(f"--from {text} lacks the port of the leader. Give {text}:/dev/ttyACM1, or {text}:twin")
    # A colon separates the id from the port. But a port's path may contain colons, too, as udev's by-path names do.
    if ":" in place and not os.path.exists(place):
        place, _, own_id = place.rpartition(":")
        if leader_id not in (None, own_id):
            raise ValueError(f"--from {text} and --leader-id {leader_id} have different ids. Give only one")
        leader_id = own_id
    if place == TWIN:
        return Teleoperator(name, transport=TWIN, relative=relative, id=leader_id)
    return Teleoperator(name, port=place, relative=relative, id=leader_id)


@contextlib.contextmanager
def _connected(arm: RealRobot) -> Iterator[None]:
    try:
        if problem := arm.connect_eagerly():
            raise Problem(problem)
        yield
    finally:
        warn_unless_safe(arm.name, arm.cleanup())


def _run(arm: RealRobot, keys: Keys | None, is_arm: bool, is_terminal: bool, quiet: bool) -> dict[str, Any]:
    """Wait until the teleoperation has ended. Return its last status."""
    shown_s, status = 0.0, _status(arm)
    shown: tuple[str, ...] = ()
    try:
        with _keys_at_once() if is_terminal else contextlib.nullcontext():
            if not quiet:
                print(_help(keys, is_arm, is_terminal), file=sys.stderr)
            while status["running"]:
                if is_terminal and not _read(arm, keys):
                    break
                if not is_terminal:
                    time.sleep(TURN_S)
                if keys is not None:
                    hold = keys.hold(time.monotonic())
                    arm.operate(hold.held, **hold.rates)
                if time.monotonic() >= shown_s:
                    shown_s = time.monotonic() + SHOW_S
                    status = _status(arm)
                    if not quiet:
                        shown = _show(status, shown)
    except KeyboardInterrupt:
        pass
    finally:
        arm.stop_task()
    if not quiet:
        print(file=sys.stderr)
    return _status(arm)


def _read(arm: RealRobot, keys: Keys | None) -> bool:
    """Wait ``TURN_S`` for pressed keys and handle them. Return False if the teleoperation has to end."""
    readable, _, _ = select.select([sys.stdin], [], [], TURN_S)
    if not readable:
        return True
    typed = os.read(sys.stdin.fileno(), 1024).decode(errors="replace")
    if not typed:
        return False  # The terminal was closed.
    for key in typed:
        if key in QUIT:
            return False
        if key == ENTER:
            arm.stop()
        elif keys is not None:
            keys.press(key.lower(), time.monotonic())
    return True


def _status(arm: RealRobot) -> dict[str, Any]:
    status: dict[str, Any] = arm.get_task_status()["content"][0]["json"]
    return status


def _show(status: dict[str, Any], shown: tuple[str, ...]) -> tuple[str, ...]:
    """Print a status. If stderr is not a terminal, print it only if it differs from ``shown``, the last printed
    status. Return the last printed status."""
    teleop = status["teleop"]
    ends = f"; at its end: {', '.join(teleop['at_end'])}" if teleop["at_end"] else ""
    line = f"{teleop['state']:9} {status['steps']:6} setpoints {teleop['refused']:4} refused  {teleop['why']}{ends}"
    if is_lost(status):
        line = f"{teleop['state']:9} {teleop['leader']}"
    if sys.stderr.isatty():
        width = shutil.get_terminal_size().columns - 1
        print(f"\r\x1b[K{line[:width]}", end="", file=sys.stderr, flush=True)
    elif shown != (now := _brief(status)):
        print(line, file=sys.stderr, flush=True)
        return now
    return shown


def _brief(status: dict[str, Any]) -> tuple[str, ...]:
    teleop = status["teleop"]
    return teleop["state"], teleop["why"], teleop["leader"]


def _page(arm: RealRobot, page: Teleoperator) -> str:
    """Wait until the web page has an address. Return the instruction to open the page."""
    while not (address := page.address) and _status(arm)["running"]:
        time.sleep(TURN_S)
    return how_to_open(page.name, address) if address else "the teleoperation has ended before the page was ready"


def how_to_open(name: str, address: str) -> str:
    """Return the instruction by which the operator opens a web page.

    Args:
        name: The page as requested: ``page``, ``gamepad`` or ``phone``.
        address: The URL of the page.
    """
    parts = urlsplit(address)
    text = f"open {address}"
    if parts.scheme == "https":
        from strands_actors.surfaces.web.certificates import certificate_for
        from strands_actors.surfaces.web.qr import qr_terminal

        certificate = certificate_for(str(parts.hostname), data_dir() / "console")
        text += f"\n{qr_terminal(address)}\nits certificate: {certificate.fingerprint}"
    elif name == PHONE:
        port = parts.port
        text += f"\non a phone that is plugged in: adb reverse tcp:{port} tcp:{port}, then open it there"
    return text


def _help(keys: Keys | None, is_arm: bool, is_terminal: bool) -> str:
    ends = "x ends it, Enter de-energises" if is_terminal else "Ctrl-C ends it"
    if keys is None and not is_arm:
        return f"operate it there. {ends}"
    if keys is None:
        return f"squeeze the leader's gripper twice to engage, and twice to let go. {ends}"
    if not keys.bindings:
        return f"hold the space bar to engage. {ends}"
    pairs: dict[str, list[str]] = {}
    for key, (axis, _) in keys.bindings.items():
        pairs.setdefault(axis, []).append(key)
    bindings = ", ".join(f"{'/'.join(pair)} {axis}" for axis, pair in pairs.items())
    return f"hold a key to move: {bindings}. {ends}"


@contextlib.contextmanager
def _keys_at_once() -> Iterator[None]:
    """Let the terminal deliver each key at once and without echo while the block runs."""
    import termios
    import tty

    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)

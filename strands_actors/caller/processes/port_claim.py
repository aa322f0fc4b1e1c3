"""Lock a port or an address for one tree. Its root holds the lock of a file in the run directory as long as
it runs.

A serial port has a lock of the operating system, too, but an address has no lock. Without this one, a robot
at an address obeyed two programs, and after a stop by one program the setpoints of the other continued.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
from pathlib import Path

import msgspec
import trio

from strands_actors.contract.loading import place_of
from strands_actors.contract.shown import harmless
from strands_actors.drivers import PLAIN
from strands_actors.kernel.processes.process import exists
from strands_actors.supervisors.root.locks import place_of_port

from .plan import Plan
from .robot_processes import NotConnected
from .run_directory import Held, Note, notes, run_dir, try_lock

SUFFIX = ".port"
LEAVING_S = 3.0
"""How long to wait for the root of a program that has ended. The root makes its robot safe first."""
PATIENCE_S = 0.3
"""How long to wait for a root if its program continues: the root may be ending."""
LOOK_S = 0.01
_SHOWN = 60
_HOLDER_BYTES = 4096


class Holder(msgspec.Struct, frozen=True):
    """The holder of a port."""

    robot: str
    pid: int  # of the program


async def claim_port(plan: Plan, robot: str) -> Held:
    """Lock the plan's port, for the root to inherit the lock. Raise ``NotConnected`` if another tree has
    it."""
    path = run_dir() / f"{hashlib.sha256(place(plan).encode()).hexdigest()[:16]}{SUFFIX}"
    held = Held(path)
    try:
        began_s = trio.current_time()
        while not (try_lock(held.fd, fcntl.LOCK_EX) and held.is_at(path)):
            if not held.is_at(path):
                held.close()
                held = Held(path)
                continue
            holder = _holder(path)
            if trio.current_time() > began_s + (PATIENCE_S if _goes_on(holder, robot) else LEAVING_S):
                raise NotConnected(_refusal(plan, holder))
            await trio.sleep(LOOK_S)
        os.ftruncate(held.fd, 0)
        os.pwrite(held.fd, msgspec.json.encode(Holder(robot, os.getpid())), 0)
    except BaseException:
        held.close()
        raise
    return held


def place(plan: Plan) -> str:
    """Return the text that identifies a place. A place may have one tree at a time.

    A serial device is a place for all drivers. An address is a place for each driver, since an arm and its
    gripper may share an address. Without a port, the place is the robot with its options and its network
    (``ROS_DOMAIN_ID``), since the driver finds the robot by them.
    """
    port, kind = place_of_port(plan.port), place_of(plan.driver_class)
    if os.path.isabs(port):
        return port
    if kind == PLAIN:  # This driver serves many robot classes.
        kind = f"{kind} {plan.robot}"
    if port:
        apart = [f" {plan.options.get(key)}" for key in plan.driver_class.TOLD_APART_BY]
        return f"{kind} {port.lower()}{''.join(apart)}"
    chosen = {key: value for key, value in plan.options.items() if key != "tool_name"}
    network = os.environ.get("ROS_DOMAIN_ID", "")
    return f"{kind} {plan.robot} {network} {sorted(chosen.items())!r}"


def _goes_on(holder: Holder | None, robot: str) -> bool:
    """Return True if the holder's program runs. A holder of our own name in this process is our former
    root, which is ending, so it does not count."""
    if holder is None or (holder.robot == robot and holder.pid == os.getpid()):
        return False
    return exists(holder.pid)


def _refusal(plan: Plan, holder: Holder | None) -> str:
    where = plan.port or f"{plan.robot} without a port"
    if holder is None:
        return f"{where}: in use by another robot. Try again when it has ended"
    robot, pid = harmless(holder.robot), holder.pid
    unconfirmed = next((note.unconfirmed for note in _notes() if note.robot == holder.robot), [])
    if unconfirmed or not _goes_on(holder, ""):
        waits = f", which have not confirmed: {', '.join(map(harmless, unconfirmed))}" if unconfirmed else ""
        return (
            f"{where}: in use by robot {robot} (process {pid}), whose root still makes its motors safe{waits}. "
            "Try again when it has; it gives up after a minute"
        )
    return (
        f"{where}: in use by robot {robot} (process {pid}: {_command(pid)}). Use that one, or end it first: "
        f"cleanup(), or the end of its program. `strands-actors stop {robot}` stops it"
    )


def _notes() -> list[Note]:
    with contextlib.suppress(OSError):
        return list(notes())
    return []


def _holder(path: Path) -> Holder | None:
    """Return the holder of a port; None while the file is being written."""
    try:
        with path.open("rb") as file:
            return msgspec.json.decode(file.read(_HOLDER_BYTES), type=Holder)
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError):
        return None


def _command(pid: int) -> str:
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    except OSError:
        words = ""
    words = harmless(words or "a program")
    return words if len(words) <= _SHOWN else f"{words[: _SHOWN - 3]}..."

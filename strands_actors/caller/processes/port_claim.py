"""Lock a port or an address, so that only the processes of one robot use it.

The robot's root process holds the lock of a file in the run directory as long as it runs.

The operating system locks a serial port, but not an address. Without this lock, a robot at an address obeyed
two programs. After a stop by one program, the setpoints of the other program continued.
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
from .run_directory import LockFile, Note, notes, run_dir, try_lock

SUFFIX = ".port"
LEAVING_S = 3.0
"""How long to wait for the root of a program that has ended. The root makes its robot safe first."""
PATIENCE_S = 0.3
"""How long to wait for a root if its program continues: the root may be ending."""
LOOK_S = 0.01
_SHOWN = 60
_HOLDER_BYTES = 4096


class Holder(msgspec.Struct, frozen=True):
    """The robot and the program that use a port."""

    robot: str
    # Process id of the program that started the robot.
    pid: int


async def claim_port(plan: Plan, robot: str) -> LockFile:
    """Lock the port of a plan, and return the locked file. The root process inherits the lock.

    Raise ``NotConnected`` if another robot uses the port.
    """
    path = run_dir() / f"{hashlib.sha256(port_identity(plan).encode()).hexdigest()[:16]}{SUFFIX}"
    lock_file = LockFile(path)
    try:
        began_s = trio.current_time()
        while not (try_lock(lock_file.fd, fcntl.LOCK_EX) and lock_file.matches(path)):
            if not lock_file.matches(path):
                lock_file.close()
                lock_file = LockFile(path)
                continue
            holder = _holder(path)
            if trio.current_time() > began_s + (PATIENCE_S if _goes_on(holder, robot) else LEAVING_S):
                raise NotConnected(_refusal(plan, holder))
            await trio.sleep(LOOK_S)
        os.ftruncate(lock_file.fd, 0)
        os.pwrite(lock_file.fd, msgspec.json.encode(Holder(robot, os.getpid())), 0)
    except BaseException:
        lock_file.close()
        raise
    return lock_file


def port_identity(plan: Plan) -> str:
    """Return a text that identifies the port or address of a robot. Only one robot may use it at a time.

    A serial device has one text for all drivers. The text of an address includes the driver, since an arm and
    its gripper may share an address. Without a port, the text has the robot with its options and its network
    (``ROS_DOMAIN_ID``), since the driver finds the robot by them.
    """
    port, driver = place_of_port(plan.port), place_of(plan.driver_class)
    if os.path.isabs(port):
        return port
    # Many robot classes share this driver, so the name of the robot is part of the text.
    if driver == PLAIN:
        driver = f"{driver} {plan.robot}"
    if port:
        apart = [f" {plan.options.get(key)}" for key in plan.driver_class.DISTINGUISHED_BY]
        return f"{driver} {port.lower()}{''.join(apart)}"
    chosen = {key: value for key, value in plan.options.items() if key != "tool_name"}
    network = os.environ.get("ROS_DOMAIN_ID", "")
    return f"{driver} {plan.robot} {network} {sorted(chosen.items())!r}"


def _goes_on(holder: Holder | None, robot: str) -> bool:
    """Return True if the program that uses the port still runs.

    If the holder is this robot in this process, it is our former root process, which is ending. Then return
    False.
    """
    if holder is None or (holder.robot == robot and holder.pid == os.getpid()):
        return False
    return exists(holder.pid)


def _refusal(plan: Plan, holder: Holder | None) -> str:
    port = plan.port or f"{plan.robot} without a port"
    if holder is None:
        return f"{port}: in use by another robot. Try again when it has ended"
    robot, pid = harmless(holder.robot), holder.pid
    unconfirmed = next((note.unconfirmed for note in _notes() if note.robot == holder.robot), [])
    if unconfirmed or not _goes_on(holder, ""):
        waits = f", which have not confirmed: {', '.join(map(harmless, unconfirmed))}" if unconfirmed else ""
        return (
            f"{port}: in use by robot {robot} (process {pid}), whose root still makes its motors safe{waits}. "
            "Try again when it has; it gives up after a minute"
        )
    return (
        f"{port}: in use by robot {robot} (process {pid}: {_command(pid)}). Use that one, or end it first: "
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

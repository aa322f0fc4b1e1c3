"""The run directory: the sockets of this user's robots, and a note for each robot on how to reach it.

It is ``$STRANDS_ACTORS_RUN``, or ``$XDG_RUNTIME_DIR/strands-actors``, or ``/tmp/strands-actors-<uid>``. Only
the user may access it. A running robot holds the exclusive lock of the file of its name. Another process can
get a shared lock of this file only if the robot has ended.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
import tempfile
import threading
import time
import weakref
from collections.abc import Iterator
from pathlib import Path

import msgspec

from strands_actors.kernel.channels.zenoh_session import unix_endpoint

from .leftovers import remove_leftovers

MAX_SOCKET_PATH = 100
"""Longest path of a unix socket in bytes (108 on Linux, minus the suffix of zenoh)."""


NOTE_BYTES = 16 * 1024
"""Longest note in bytes. A longer file is not a note."""
PATIENCE_S = 0.5
"""How long a robot that starts waits for processes that only test whether its name is free."""
LOOK_S = 0.001


class Note(msgspec.Struct):
    """How to reach the processes of a robot. A robot writes it to a file, its note.

    If the file cannot be read, ``problem`` has the reason. The sockets are then those that follow from the
    robot's name.
    """

    robot: str
    kind: str
    pid: int
    # Addresses of the sockets of the robot's actors.
    endpoints: list[str]
    # Addresses of the sockets of the robot's topics, for subscribers.
    mesh: list[str] = []
    problem: str = ""
    # Motors that have not confirmed the safe state. The root process keeps trying.
    unconfirmed: list[str] = []
    # Longest time of a stop in seconds (``Timing.safe_s``).
    safe_s: float = 1.5
    # Longest time in seconds for which an earlier request may still take effect (``Driver.late_s``).
    late_s: float = 0.0
    # Longest time for arming in seconds (``Timing.arm_s``).
    arm_s: float = 10.0
    # Axes of the robot that may be energised.
    motors: list[str] = []
    # Port of the robot, as the script gave it; empty for a simulated robot or without a port.
    port: str = ""
    # Process id of the host that keeps the robot for other programs; 0 for the robot of a script.
    host: int = 0


def run_dir() -> Path:
    """Return the directory, and create it if necessary. Raise ``PermissionError`` if other users can access
    it."""
    named = os.environ.get("STRANDS_ACTORS_RUN")
    base = os.environ.get("XDG_RUNTIME_DIR")
    if not named and not base:
        return _shared_place(Path(tempfile.gettempdir()) / f"strands-actors-{os.getuid()}")
    path = Path(named) if named else Path(base or "") / "strands-actors"
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    _check(path, path.stat())
    return path


def _shared_place(path: Path) -> Path:
    """Return the run directory in a folder that all users may write, such as /tmp.

    Raise ``PermissionError`` if another user may have made the directory. A symbolic link of another user could
    lead our sockets and notes elsewhere, even while a robot runs. So links are refused.
    """
    with contextlib.suppress(FileExistsError):
        path.mkdir(mode=0o700)
    parent = path.parent.stat().st_mode
    if parent & 0o002 and not parent & stat.S_ISVTX:
        raise PermissionError(f"{path.parent} lets others rename what is ours. {_ELSEWHERE}")
    try:
        fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        reason = "is a link" if path.is_symlink() else f"cannot be opened ({error.strerror})"
        raise PermissionError(f"{path} {reason}: somebody else may have put it there. {_ELSEWHERE}") from None
    try:
        _check(path, os.fstat(fd))
    finally:
        os.close(fd)
    return path


def _check(path: Path, status: os.stat_result) -> None:
    if status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise PermissionError(f"{path} is open to others: chmod 700 it. {_ELSEWHERE}")


_ELSEWHERE = "Or set STRANDS_ACTORS_RUN to another place"


def data_dir() -> Path:
    """Return the directory of files that survive a reboot: ``$STRANDS_ACTORS_DATA``, or
    ``$XDG_DATA_HOME/strands-actors``, or ``~/.local/share/strands-actors``."""
    named, base = os.environ.get("STRANDS_ACTORS_DATA"), os.environ.get("XDG_DATA_HOME")
    if named:
        return Path(named)
    return (Path(base) if base else Path.home() / ".local" / "share") / "strands-actors"


def locks_dir() -> Path:
    """Return the directory of the locks of e-stops."""
    return data_dir() / "locks"


def audit_file(robot: str) -> Path:
    """Return the file of a robot's audit: the commands and their senders (``supervisors/root/audit.py``)."""
    return data_dir() / "audit" / f"{robot}.jsonl"


def socket_path(directory: Path, robot: str, role: str) -> str:
    return str(directory / f"{robot}.{role}.sock")


class LockFile:
    """An open file with a lock. Of all forked children only a root process inherits it.

    Any other child (such as a worker of ``multiprocessing``) closes the file. Otherwise the child would keep
    the lock after the end of the robot.
    """

    def __init__(self, path: Path) -> None:
        with _forking:
            self.fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            _lock_files.add(self)

    def matches(self, path: Path) -> bool:
        """Return True if ``path`` still leads to this file.

        Another process may remove the file after it was opened and before it is locked (``leftovers``).
        """
        try:
            return os.path.samestat(os.fstat(self.fd), path.stat())
        except FileNotFoundError:
            return False

    def close(self) -> None:
        """Close the file. A root process (the supervisor) that has inherited it keeps the lock as long as it runs.
        A second call changes nothing."""
        with _forking:
            fd, self.fd = self.fd, -1
            _lock_files.discard(self)
            if fd >= 0:
                os.close(fd)


_lock_files: weakref.WeakSet[LockFile] = weakref.WeakSet()
_forking = threading.RLock()
"""Held during a fork, and while a file is opened and added to ``_lock_files``. So a child closes every such
file."""


def _forget_in_child() -> None:
    for lock_file in list(_lock_files):
        lock_file.close()
    _forking.release()


os.register_at_fork(before=_forking.acquire, after_in_parent=_forking.release, after_in_child=_forget_in_child)


class NameTaken(Exception):
    """Another robot has the requested name."""


class Name:
    """The reserved name of a robot. The robot's root process inherits the lock of the name.

    Args:
        requested: The requested name. If another robot has it, a number is added.
        exact: Raise ``NameTaken`` instead of adding a number.
    """

    def __init__(self, requested: str, exact: bool = False) -> None:
        directory = run_dir()
        for number in range(1, 2 if exact else 1000):
            self.name = requested if number == 1 else f"{requested}-{number}"
            path = directory / f"{self.name}.lock"
            while True:
                self._lock = LockFile(path)
                is_reserved = _take(self._lock.fd)
                if not is_reserved or self._lock.matches(path):
                    break
                self._lock.close()
            if is_reserved:
                # This note belongs to a robot of the same name that has ended.
                (directory / f"{self.name}.json").unlink(missing_ok=True)
                return
            self._lock.close()
        if exact:
            raise NameTaken(f"another robot of this user has the name {requested}, or is still ending")
        raise RuntimeError(f"999 robots named {requested} run already. End some of them, or give another id")

    @property
    def lock_fd(self) -> int:
        """Return the descriptor of the locked file, which the robot's root process (the supervisor) inherits."""
        return self._lock.fd

    def socket(self, role: str) -> str:
        """Return the path of the socket of one of the robot's processes, given by its role. Raise ``ValueError``
        if it is too long.
        """
        path = socket_path(run_dir(), self.name, role)
        if len(path.encode()) > MAX_SOCKET_PATH:
            raise ValueError(
                f"{path} is too long for the path of a socket. Set STRANDS_ACTORS_RUN to a shorter path"
            )
        return path

    @property
    def note(self) -> Path:
        """Return the path of the file that describes the running robot."""
        return run_dir() / f"{self.name}.json"

    def path_with_suffix(self, suffix: str) -> Path:
        """Return the path of another file of this robot in the run directory, by its suffix."""
        return run_dir() / f"{self.name}{suffix}"

    def publish(self, note: Note) -> None:
        target = self.note
        draft = target.with_suffix(".tmp")
        draft.write_bytes(msgspec.json.encode(note))
        draft.replace(target)

    def release(self) -> None:
        """Close the locked file. The robot's root process (the supervisor) keeps the lock as long as it runs."""
        self._lock.close()


def _take(lock_fd: int) -> bool:
    """Lock the file of a name. Return False if another robot has the name.

    Other processes hold the shared lock only for a moment, to test the name. Wait for them.
    """
    until_s = time.monotonic() + PATIENCE_S
    while not try_lock(lock_fd, fcntl.LOCK_EX):
        if not try_lock(lock_fd, fcntl.LOCK_SH) or time.monotonic() > until_s:
            return False
        fcntl.flock(lock_fd, fcntl.LOCK_UN)
        time.sleep(LOOK_S)
    return True


def try_lock(lock_fd: int, how: int) -> bool:
    """Try to get a lock without waiting. Return True if it was free.

    Args:
        lock_fd: Descriptor of the file.
        how: ``fcntl.LOCK_EX`` or ``fcntl.LOCK_SH``.
    """
    try:
        fcntl.flock(lock_fd, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def is_running(robot: str) -> bool:
    """Return True if a robot of this name runs."""
    try:
        fd = os.open(run_dir() / f"{robot}.lock", os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        return not try_lock(fd, fcntl.LOCK_SH)
    finally:
        os.close(fd)


def notes() -> Iterator[Note]:
    """Yield the notes of all robots that run, and remove the files of robots that have ended.

    Raises:
        OSError: The directory cannot be used. A note that cannot be read raises nothing.
    """
    directory = run_dir()
    remove_leftovers(directory)
    for name in sorted(path.stem for path in directory.glob("*.json")):
        if is_running(name):
            note = _read(directory, name)
            if note is not None:
                yield note


def _read(directory: Path, name: str) -> Note | None:
    """Return the note of a robot; None if it has just been removed."""
    path = directory / f"{name}.json"
    try:
        if not path.is_file():
            return None if not path.exists() else _by_name(directory, name, "it is no file")
        with path.open("rb") as file:
            note = msgspec.json.decode(file.read(NOTE_BYTES), type=Note)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return _by_name(directory, name, str(error))
    if note.robot != name or not all(map(_is_endpoint, (*note.endpoints, *note.mesh))):
        return _by_name(directory, name, "it names another robot, or what is no socket")
    return note


def _is_endpoint(endpoint: str) -> bool:
    return endpoint.startswith(unix_endpoint("/")) and endpoint.endswith(".sock") and "#" not in endpoint


def _by_name(directory: Path, name: str, problem: str) -> Note:
    """Return a note that is made from the name of a running robot, if the real note cannot be read."""
    root, wire, mesh = (unix_endpoint(socket_path(directory, name, role)) for role in ("root", "wire", "mesh"))
    return Note(
        name, "unknown", 0, [root, wire], [mesh], f"its note {directory / name}.json cannot be read: {problem}"
    )

"""The directory where the robots of this user meet: sockets, and one note a robot on how to reach
it.

``$STRANDS_ACTORS_RUN``, else ``$XDG_RUNTIME_DIR/strands-actors``, else
``/tmp/strands-actors-<uid>``; for the user alone. A robot's name is its own for as long as a
process holds its lock exclusively. Who looks whether one does tries a shared lock: when it gets
that, the robot has ended.
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
"""Bytes a unix socket's path may have (108 on Linux, less what zenoh appends)."""


NOTE_BYTES = 16 * 1024
"""More is no note."""
PATIENCE_S = 0.5
"""Of a robot that starts, with others who look whether its name is free."""
LOOK_S = 0.001


class Note(msgspec.Struct):
    """How to reach a robot's tree. ``problem``: why the note that lies there cannot be read; then
    the sockets are those that it must have by its name."""

    robot: str
    kind: str
    pid: int
    endpoints: list[str]  # of its actors
    mesh: list[str] = []  # of its topics: what a subscriber connects to
    problem: str = ""
    unconfirmed: list[str] = []  # motors that its root could not confirm safe so far, and goes on trying
    safe_s: float = 1.5  # what its driver says that a stop may take
    late_s: float = 0.0  # and how much later something that was asked for before may take effect
    arm_s: float = 10.0  # and that energising it may
    motors: list[str] = []  # all that may be energised: its axes
    port: str = ""  # where it is, as its script said; empty: a twin, or none was given


def run_dir() -> Path:
    """Return the directory, made if need be. Raise ``PermissionError`` when it is not ours
    alone."""
    named = os.environ.get("STRANDS_ACTORS_RUN")
    base = os.environ.get("XDG_RUNTIME_DIR")
    if not named and not base:
        return _shared_place(Path(tempfile.gettempdir()) / f"strands-actors-{os.getuid()}")
    path = Path(named) if named else Path(base or "") / "strands-actors"
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    _check(path, path.stat())
    return path


def _shared_place(path: Path) -> Path:
    """As ``run_dir``, where others may have put something under that name before us: a link to a
    directory of ours would lead sockets and notes there, and elsewhere while a robot runs."""
    with contextlib.suppress(FileExistsError):
        path.mkdir(mode=0o700)
    parent = path.parent.stat().st_mode
    if parent & 0o002 and not parent & stat.S_ISVTX:
        raise PermissionError(f"{path.parent} lets others rename what is ours. {_ELSEWHERE}")
    try:
        fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        why = "is a link" if path.is_symlink() else f"cannot be opened ({error.strerror})"
        raise PermissionError(f"{path} {why}: somebody else may have put it there. {_ELSEWHERE}") from None
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
    """Return what is to survive a reboot: ``$STRANDS_ACTORS_DATA``, else
    ``$XDG_DATA_HOME/strands-actors``, else ``~/.local/share/strands-actors``."""
    named, base = os.environ.get("STRANDS_ACTORS_DATA"), os.environ.get("XDG_DATA_HOME")
    if named:
        return Path(named)
    return (Path(base) if base else Path.home() / ".local" / "share") / "strands-actors"


def locks_dir() -> Path:
    """Return where the locks of e-stops lie."""
    return data_dir() / "locks"


def audit_file(robot: str) -> Path:
    """Return where it is written who told a robot what (``supervisors/root/audit.py``)."""
    return data_dir() / "audit" / f"{robot}.jsonl"


def socket_path(directory: Path, robot: str, role: str) -> str:
    return str(directory / f"{robot}.{role}.sock")


class Held:
    """An open file whose lock is for a root to inherit, and for nobody else. A child that this
    program forks (a worker of ``multiprocessing``) closes it: it would keep the lock of a robot that
    has ended for as long as it lives."""

    def __init__(self, path: Path) -> None:
        with _forking:
            self.fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            _held.add(self)

    def is_at(self, path: Path) -> bool:
        """Return whether ``path`` still leads to this file. A file that nobody had locked may have been
        removed between its opening and its lock (``leftovers``)."""
        try:
            return os.path.samestat(os.fstat(self.fd), path.stat())
        except FileNotFoundError:
            return False

    def close(self) -> None:
        """Let go of our hold; a root's own lives as long as it does. Harmless when called again."""
        with _forking:
            fd, self.fd = self.fd, -1
            _held.discard(self)
            if fd >= 0:
                os.close(fd)


_held: weakref.WeakSet[Held] = weakref.WeakSet()
_forking = threading.RLock()
"""Nobody forks between the opening of a file and its place among those that a child closes."""


def _forget_in_child() -> None:
    for held in list(_held):
        held.close()
    _forking.release()


os.register_at_fork(before=_forking.acquire, after_in_parent=_forking.release, after_in_child=_forget_in_child)


class Name:
    """A robot's name, held by a lock that the tree's root inherits."""

    def __init__(self, wanted: str) -> None:
        directory = run_dir()
        for number in range(1, 1000):
            self.name = wanted if number == 1 else f"{wanted}-{number}"
            path = directory / f"{self.name}.lock"
            while True:
                self._lock = Held(path)
                taken = _take(self._lock.fd)
                if not taken or self._lock.is_at(path):
                    break
                self._lock.close()
            if taken:
                (directory / f"{self.name}.json").unlink(missing_ok=True)  # of who had it before
                return
            self._lock.close()
        raise RuntimeError(f"there are 999 robots called {wanted} already")

    @property
    def lock_fd(self) -> int:
        """Return the descriptor, for a root to inherit."""
        return self._lock.fd

    def socket(self, role: str) -> str:
        """Return the path of a process's socket. Raise ``ValueError`` when it is too long for
        one."""
        path = socket_path(run_dir(), self.name, role)
        if len(path.encode()) > MAX_SOCKET_PATH:
            raise ValueError(f"{path} is too long for a socket: set STRANDS_ACTORS_RUN to a shorter place")
        return path

    @property
    def note(self) -> Path:
        """Return where it is published."""
        return run_dir() / f"{self.name}.json"

    def beside(self, suffix: str) -> Path:
        """Return the path of another file of this robot."""
        return run_dir() / f"{self.name}{suffix}"

    def publish(self, note: Note) -> None:
        target = self.note
        draft = target.with_suffix(".tmp")
        draft.write_bytes(msgspec.json.encode(note))
        draft.replace(target)

    def release(self) -> None:
        """Close our hold; the root's own lives as long as it does."""
        self._lock.close()


def _take(lock_fd: int) -> bool:
    """Take a name; False when another robot has it. Who only looks is waited for."""
    until_s = time.monotonic() + PATIENCE_S
    while not try_lock(lock_fd, fcntl.LOCK_EX):
        if not try_lock(lock_fd, fcntl.LOCK_SH) or time.monotonic() > until_s:
            return False
        fcntl.flock(lock_fd, fcntl.LOCK_UN)
        time.sleep(LOOK_S)
    return True


def try_lock(lock_fd: int, how: int) -> bool:
    """Return whether it was to be had."""
    try:
        fcntl.flock(lock_fd, how | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def is_held(robot: str) -> bool:
    """Return whether a process has that name."""
    try:
        fd = os.open(run_dir() / f"{robot}.lock", os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        return not try_lock(fd, fcntl.LOCK_SH)
    finally:
        os.close(fd)


def notes() -> Iterator[Note]:
    """Return the notes of all robots that run, and remove the files of those that have ended. Raise
    ``OSError`` when the directory cannot be used, and for no note in it."""
    directory = run_dir()
    remove_leftovers(directory)
    for name in sorted(path.stem for path in directory.glob("*.json")):
        if is_held(name):
            note = _read(directory, name)
            if note is not None:
                yield note


def _read(directory: Path, name: str) -> Note | None:
    """None when it has just been taken away."""
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


def _by_name(directory: Path, name: str, why: str) -> Note:
    """Of a robot that runs and whose note says nothing: its sockets have their names all the
    same."""
    root, wire, mesh = (unix_endpoint(socket_path(directory, name, role)) for role in ("root", "wire", "mesh"))
    return Note(name, "unknown", 0, [root, wire], [mesh], f"its note {directory / name}.json cannot be read: {why}")

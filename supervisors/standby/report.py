"""What a standby leaves in the run directory: a report of what it did, for the next robot of that
name; and, while it lives, a lock, for which the next robot waits: so a standby never writes to a
robot that is another tree's. One that the system has stopped is ended by the next robot.
"""

from __future__ import annotations

import fcntl
import os
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.processes.child import report_failure

REPORT = ".standby.report"
LOCK = ".standby.life"
_REPORT_BYTES = 64 * 1024


class StandbyReport(msgspec.Struct, frozen=True):
    """``over``: it does nothing more. ``place``: as ``caller/port_claim`` tells robots apart; empty for
    a twin, which is known by the robot's name alone. ``at``: ISO 8601, UTC, of the
    file; filled in by who reads it."""

    robot: str
    place: str
    why: str  # what was seen of root and wire
    safe_state: str
    confirmed: bool
    motors: tuple[MotorReport, ...]
    attempts: int
    over: bool
    pid: int = 0
    at: str = ""

    @property
    def text(self) -> str:
        """For people."""
        done = "every motor confirmed it"
        if not self.confirmed:
            unsafe = [f"{motor.axis} ({motor.detail})" for motor in self.motors if not motor.safe]
            done = f"it is not confirmed by {', '.join(unsafe) or 'anybody'}"
            done += ". It has given up: look at the robot" if self.over else ". It tries again"
        return f"{self.why}: the standby ordered {self.safe_state}, {done} ({self.at or 'just now'})"


def write(path: Path, report: StandbyReport) -> None:
    """Raise ``OSError``."""
    draft = path.with_suffix(f".{os.getpid()}.tmp")
    draft.write_bytes(msgspec.json.encode(report))
    draft.replace(path)


def read(path: Path) -> StandbyReport | None:
    """None when there is none. One that cannot be read is told as such."""
    try:
        with path.open("rb") as file:
            data, since_s = file.read(_REPORT_BYTES), os.fstat(file.fileno()).st_mtime
    except FileNotFoundError:
        return None
    except OSError as error:
        return _unreadable(path, str(error))
    at = datetime.fromtimestamp(since_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    try:
        return msgspec.structs.replace(msgspec.json.decode(data, type=StandbyReport), at=at)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        return _unreadable(path, str(error))


def _unreadable(path: Path, why: str) -> StandbyReport:
    return StandbyReport(
        path.name.removesuffix(REPORT), "", f"{path} cannot be read: {why}", "?", False, (), 0, True
    )


class LifeLock:
    """Held by a standby as long as it lives. Whoever holds it may write to the robot of that name
    and place."""

    def __init__(self, path: Path, place: str) -> None:
        """Take it. Raise ``BlockingIOError`` when another process has it, ``OSError`` when there is
        no place."""
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._fd)
            raise
        try:
            os.ftruncate(self._fd, 0)
            os.write(self._fd, msgspec.json.encode(Holder(os.getpid(), place)))
        except OSError as error:  # a full disk: the lock holds, and only its holder's pid is not known
            report_failure("the note on who holds the lock of the standby", error)


class Holder(msgspec.Struct, frozen=True):
    """The standby that lives. ``pid`` 0: it is just beginning to."""

    pid: int = 0
    place: str = ""


def holder(path: Path) -> Holder | None:
    """Return who holds a ``LifeLock``; None: nobody does."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        try:
            return msgspec.json.decode(os.read(fd, _REPORT_BYTES), type=Holder)
        except (msgspec.MsgspecError, UnicodeDecodeError):
            return Holder()
    finally:
        os.close(fd)
    return None

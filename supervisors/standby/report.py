"""The files of a standby in the run directory.

The report describes how the standby stopped the robot. The next start of a robot with the same name reads it. The
standby holds the lock while it runs, and the next start waits for this lock. So a standby never writes to a robot
that is already used by a new start. If the standby's process was suspended (SIGSTOP), the next start kills it.
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
    """The report of a stop by the standby.

    Attributes:
        robot: Name of the robot.
        place: Port or address of the robot, in the form of ``caller/port_claim``; empty for a simulated robot,
            which is known by its name only.
        cause: The state of root and wire, as the standby observed it.
        safe_state: The safe state that was ordered.
        confirmed: True if every motor confirmed it.
        motors: The last report of each motor.
        attempts: Number of times that the safe state was written.
        over: True if the standby has ended its attempts.
        pid: Process id of the standby.
        time: Time of the file, ISO 8601 in UTC; set by ``read``.
    """

    robot: str
    place: str
    cause: str = msgspec.field(name="why")
    safe_state: str
    confirmed: bool
    motors: tuple[MotorReport, ...]
    attempts: int
    over: bool
    pid: int = 0
    time: str = msgspec.field(name="at", default="")

    @property
    def text(self) -> str:
        """Return the report as a sentence for people."""
        done = "every motor confirmed it"
        if not self.confirmed:
            unsafe = [f"{motor.axis} ({motor.detail})" for motor in self.motors if not motor.safe]
            done = f"it is not confirmed by {', '.join(unsafe) or 'anybody'}"
            done += ". It has given up: look at the robot" if self.over else ". It tries again"
        return f"{self.cause}: the standby ordered {self.safe_state}, {done} ({self.time or 'just now'})"


def write(path: Path, report: StandbyReport) -> None:
    """Write the report to the disk, in place of an earlier one. Raise ``OSError`` if that fails."""
    draft = path.with_suffix(f".{os.getpid()}.tmp")
    draft.write_bytes(msgspec.json.encode(report))
    draft.replace(path)


def read(path: Path) -> StandbyReport | None:
    """Return the report, or None if there is no file. If the file cannot be read, return a report with the
    error."""
    try:
        with path.open("rb") as file:
            data, since_s = file.read(_REPORT_BYTES), os.fstat(file.fileno()).st_mtime
    except FileNotFoundError:
        return None
    except OSError as error:
        return _unreadable(path, str(error))
    time_text = datetime.fromtimestamp(since_s, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    try:
        return msgspec.structs.replace(msgspec.json.decode(data, type=StandbyReport), time=time_text)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        return _unreadable(path, str(error))


def _unreadable(path: Path, reason: str) -> StandbyReport:
    return StandbyReport(
        path.name.removesuffix(REPORT), "", f"{path} cannot be read: {reason}", "?", False, (), 0, True
    )


class LifeLock:
    """A lock that a standby holds while it runs. Only the process with this lock may write to the robot.

    Raises:
        BlockingIOError: Another process holds the lock.
        OSError: The file cannot be made.
    """

    def __init__(self, path: Path, place: str) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._fd)
            raise
        try:
            os.ftruncate(self._fd, 0)
            os.write(self._fd, msgspec.json.encode(Holder(os.getpid(), place)))
        # The disk is full. The lock is valid all the same, but the file lacks the process id.
        except OSError as error:
            report_failure("the file with the process id of the standby", error)


class Holder(msgspec.Struct, frozen=True):
    """The process that holds the lock of a standby. ``pid`` is 0 while the process is starting."""

    pid: int = 0
    place: str = ""


def holder(path: Path) -> Holder | None:
    """Return the process that holds a ``LifeLock``; None if the lock is free."""
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

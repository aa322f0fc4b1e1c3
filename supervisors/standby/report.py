"""The files that a standby leaves in the run directory.

The report describes the stops of the standby to the next robot of the same name. The lock is held while the
standby runs. The next robot waits for it, so that a standby never writes to a robot that belongs to another
tree. If the standby was stopped (SIGSTOP), the next robot ends it.
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
    """The stop by a standby.

    Attributes:
        robot: The robot's name.
        place: The robot's port or address, in the form of ``caller/port_claim``; empty for a twin, which is
            identified by its name alone.
        why: The observed state of root and wire.
        safe_state: The ordered safe state.
        confirmed: True if every motor confirmed it.
        motors: The last report of each motor.
        attempts: How often the safe state was written.
        over: True if the standby has finished.
        pid: The standby's process id.
        at: Time of the file, ISO 8601 in UTC; set by ``read``.
    """

    robot: str
    place: str
    why: str
    safe_state: str
    confirmed: bool
    motors: tuple[MotorReport, ...]
    attempts: int
    over: bool
    pid: int = 0
    at: str = ""

    @property
    def text(self) -> str:
        """The report as a sentence for people."""
        done = "every motor confirmed it"
        if not self.confirmed:
            unsafe = [f"{motor.axis} ({motor.detail})" for motor in self.motors if not motor.safe]
            done = f"it is not confirmed by {', '.join(unsafe) or 'anybody'}"
            done += ". It has given up: look at the robot" if self.over else ". It tries again"
        return f"{self.why}: the standby ordered {self.safe_state}, {done} ({self.at or 'just now'})"


def write(path: Path, report: StandbyReport) -> None:
    """Replace the report on the disk. Raise ``OSError``."""
    draft = path.with_suffix(f".{os.getpid()}.tmp")
    draft.write_bytes(msgspec.json.encode(report))
    draft.replace(path)


def read(path: Path) -> StandbyReport | None:
    """Return the report, or None if there is no file. For an unreadable file, return a report with the error."""
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
    """A lock that a standby holds while it lives. Only its holder may write to the robot of that
    name and place.

    Raises:
        BlockingIOError: Another process holds it.
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
        except OSError as error:  # The disk is full. The lock holds; only its holder's pid is missing.
            report_failure("the note on who holds the lock of the standby", error)


class Holder(msgspec.Struct, frozen=True):
    """The standby that holds the lock. Its ``pid`` is 0 while it is starting."""

    pid: int = 0
    place: str = ""


def holder(path: Path) -> Holder | None:
    """Return the holder of a ``LifeLock``; None if it is free."""
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

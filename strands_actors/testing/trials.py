"""Store trials as JSON lines in a file that a later run continues, so that an interrupted run loses nothing.

A run begins with a line that describes its subject: code, computer and Python. Only a run with the same subject may
continue the file.
"""

from __future__ import annotations

import hashlib
import math
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from strands_actors import drivers, supervisors
from strands_actors import kernel as runtime
from strands_actors.version import __version__

from .cells import Outcome
from .faults import Cell, Faults, victim_named
from .pairs import Pair, pair_named

_MEASURED = (".py", ".toml")


class Problem(Exception):
    """The file of trials cannot be continued. The text gives the cause."""


class Trial(msgspec.Struct, frozen=True, tag="trial"):
    """The result of one trial of a robot.

    ``time_utc`` is the time of the trial, ``load`` the load average of the last minute.
    """

    robot: str
    outcome: Outcome
    time_utc: str = msgspec.field(name="at")
    load: float

    @property
    def cell(self) -> tuple[str, str, str]:
        """The key of the trial's cell: robot, victim and fault."""
        return self.robot, self.outcome.victim, self.outcome.fault


class Run(msgspec.Struct, frozen=True, tag="run"):
    """The first line of a run: its subject (code, machine, Python), and its number of benches.

    A bench is a simulated robot with the script that moves it. All benches run at the same time.
    """

    subject: dict[str, str]
    jobs: int
    time_utc: str = msgspec.field(name="at")


def cell_named(victim: str, fault: str) -> Cell | Pair:
    """Return the cell or pair with these names. Raise ``ValueError`` if there is no such cell."""
    return Cell(victim_named(victim), Faults(fault)) if fault in list(Faults) else pair_named(victim, fault)


class Done(msgspec.Struct, frozen=True, tag="done"):
    """The last line that a worker process writes for an order (some trials of a cell).

    ``problem`` is the reason if trials are missing, and empty otherwise.
    """

    problem: str = ""


_DECODER = msgspec.json.Decoder(Trial | Run | Done)


def now() -> str:
    """Return the present time in UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S")


def trial(robot: str, outcome: Outcome) -> Trial:
    """Return a trial with this outcome, the present time, and the present load of the computer."""
    return Trial(robot, outcome, now(), round(os.getloadavg()[0], 2))


def subject() -> dict[str, str]:
    """Return the subject of a run, on which the figures depend: the code, the computer and Python.

    The load is not included.
    """
    return {
        "strands-actors": f"{__version__}, code {_digest_of_code()}",
        "machine": f"{_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.release()}",
        "python": sys.version.split()[0],
    }


def _digest_of_code() -> str:
    """Return twelve hexadecimal digits that identify the code and the tables of kernel, supervisors and drivers."""
    digest = hashlib.sha256()
    for module in (runtime, supervisors, drivers):
        folder = Path(str(module.__file__)).parent
        for path in sorted(path for path in folder.rglob("*") if path.suffix in _MEASURED):
            digest.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


# -- as lines


def encode(line: Trial | Run | Done) -> bytes:
    """Encode a trial, or the head of a run, as a line of the file.

    JSON has no infinity. So if no safe frame came, the time is 0 and ``setpoints_after`` is -1.
    """
    if isinstance(line, Trial) and math.isinf(line.outcome.safe_ms):
        line = _with_safe_ms(line, 0.0)
    return msgspec.json.encode(line) + b"\n"


def decode(line: bytes) -> Trial | Run | Done:
    """Decode a line of the file or of a worker. Raise ``msgspec.DecodeError`` if it has another form."""
    decoded = _DECODER.decode(line)
    return (
        _with_safe_ms(decoded, math.inf)
        if isinstance(decoded, Trial) and decoded.outcome.setpoints_after < 0
        else decoded
    )


def _with_safe_ms(result: Trial, safe_ms: float) -> Trial:
    return msgspec.structs.replace(result, outcome=replace(result.outcome, safe_ms=safe_ms))


class Trials:
    """All trials of a kill matrix. They are stored in a file if a path is given."""

    def __init__(self, path: Path | None, jobs: int) -> None:
        """Read the file, and add a line for the new run.

        Raise ``Problem`` if the new run cannot continue the file.
        """
        self.runs: list[Run] = []
        self.all: list[Trial] = []
        self._path = path
        if path is not None and path.exists():
            self._read(path)
        begun = Run(subject(), jobs, now())
        if self.runs and self.runs[-1].subject != begun.subject:
            raise Problem(
                f"{path} was measured with {_words(self.runs[-1])}, this is {_words(begun)}. Give another file"
            )
        self.runs.append(begun)
        self._write(begun)

    def add(self, trial: Trial) -> None:
        """Add a trial, and write it to the file."""
        self.all.append(trial)
        self._write(trial)

    def of(self, robot: str, cell: Cell | Pair) -> list[Outcome]:
        """Return the outcomes of one cell or pair of a robot, in the order in which they were added."""
        key = (robot, cell.victim, cell.fault)
        return [trial.outcome for trial in self.all if trial.cell == key]

    def _read(self, path: Path) -> None:
        for number, line in enumerate(_whole_lines(path), 1):
            try:
                decoded = decode(line)
            except msgspec.DecodeError as error:
                raise Problem(f"{path}, line {number}: {error}. Give another file") from None
            if isinstance(decoded, Trial):
                self.all.append(decoded)
            elif isinstance(decoded, Run):
                self.runs.append(decoded)

    def _write(self, line: Trial | Run) -> None:
        if self._path is not None:
            with self._path.open("ab") as file:
                file.write(encode(line))


def _whole_lines(path: Path) -> Iterator[bytes]:
    """Return the complete lines of the file.

    If an interrupted run has left an incomplete line, remove it from the file.
    """
    data = path.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if len(whole) < len(data):
        os.truncate(path, len(whole))
    return iter(whole.splitlines())


def _words(run: Run) -> str:
    return "; ".join(run.subject.values())

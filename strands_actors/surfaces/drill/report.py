"""Reports of drills, which users may send to the project: make one, write it, and read one that was sent in.

A report has a fixed set of fields. No field can identify a person or a computer. So it has no port or
address, no name of a host or user, no path, no serial number, no options, and no text of an error (which may
contain any of these). Its only text that comes from outside is the version of the firmware.

A drill on a twin makes a report, too, so that everybody can see one. Its field ``peer`` is then ``twin``.
"""

from __future__ import annotations

import enum
import math
import os
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import msgspec

from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class, list_native_drivers
from strands_actors.version import __version__

from .certificate import StepResult
from .connection import ON_THIS_COMPUTER, Connection

FORMAT = "strands-actors drill report"
VERSION = 1
FORM = "Stop drill on a real robot"
"""The name of the issue form that takes reports (``.github/ISSUE_TEMPLATE/stop_drill.yml``)."""
STEPS = ("stop", "policy kill", "wire kill", "root freeze", "link loss")
OPTIONAL = "policy kill"
"""The step that a robot without policies in a separate process leaves out."""
LOWERED = "script kill"
"""The last step for an arm that is lowered."""
LARGEST_BYTES = 64 * 1024
FIRMWARE_FACTS = ("firmware", "polyscope", "software", "daemon_version")
"""Names under which the wires report the version of a robot's software (``Wire.open``)."""

_FIRMWARE = re.compile(r"[\w .:,()+-]{1,64}", re.ASCII)
_PACKAGE = "strands_actors.drivers."


class BadReport(ValueError):
    """A file is no report, or a report that does not count. The text has the reason and the remedy."""


class Peer(enum.StrEnum):
    """The other end of the wire during the drill."""

    ROBOT = "robot"
    TWIN = "twin"
    LOCAL = "program on this computer"  # perhaps a twin: the drill cannot know it


class Step(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One step of the drill. Times are in milliseconds, counted from the fault."""

    step: str
    passed: bool
    safe_state: str
    confirmed_ms: float | None  # until every motor was read and was safe; None if that was not confirmed
    bound_ms: float


class Computer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The computer of the drill."""

    system: str
    architecture: str
    cpus: int
    python: str


class Report(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The report of one drill.

    Attributes:
        format: ``FORMAT``.
        format_version: ``VERSION``.
        peer: The other end of the wire.
        robot: The robot's name in ``Robot(...)``.
        driver: The driver class, as ``module:class``.
        wire: The folder of the driver.
        connection: The kind of the connection, without its address.
        firmware: The versions that the robot or its motors reported, without repetition; empty if it reports none.
        package_version: The version of this package.
        date: The day of the drill, in ISO 8601, UTC.
        passed: True if every step was passed.
        steps: The steps in their order.
        computer: The computer.
    """

    format: str
    format_version: int
    peer: Peer
    robot: str
    driver: str
    wire: str
    connection: Connection
    firmware: list[str]
    package_version: str
    date: str
    passed: bool
    steps: list[Step]
    computer: Computer


# -- make


def is_reportable(robot: str, driver_class: type[Driver]) -> bool:
    """Return True if a driver of this package drives the robot. The project cannot use a report of another driver,
    such as LeRobot's class."""
    return _name_of(driver_class) in _drivers_of(robot)


def _name_of(driver_class: type[Any]) -> str:
    return f"{driver_class.__module__}:{driver_class.__qualname__}"


def report_of(
    robot: str,
    driver_class: type[Driver],
    connection: Connection,
    facts: Mapping[str, Any],
    results: Sequence[StepResult],
) -> Report:
    """Return the report of a drill.

    Args:
        robot: The robot's name.
        driver_class: The driver. ``is_reportable`` must be true.
        connection: The kind of the connection; ``Connection.TWIN`` for the robot's twin.
        facts: The facts that the robot reported when it was opened.
        results: The results of the steps.
    """
    driver = _name_of(driver_class)
    return Report(
        format=FORMAT,
        format_version=VERSION,
        peer=_peer(connection),
        robot=robot,
        driver=driver,
        wire=_wire(driver),
        connection=connection,
        firmware=_firmware(facts),
        package_version=__version__,
        date=datetime.now(UTC).date().isoformat(),
        passed=all(result.passed for result in results),
        steps=[
            Step(each.step, each.passed, each.safe_state, _rounded(each.confirmed_ms), round(each.bound_ms, 1))
            for each in results
        ],
        computer=_computer(),
    )


def _computer() -> Computer:
    python = ".".join(platform.python_version_tuple()[:2])
    return Computer(platform.system(), platform.machine(), os.cpu_count() or 1, python)


def _peer(connection: Connection) -> Peer:
    if connection is Connection.TWIN:
        return Peer.TWIN
    return Peer.LOCAL if connection in ON_THIS_COMPUTER else Peer.ROBOT


def _wire(driver: str) -> str:
    return driver.removeprefix(_PACKAGE).partition(".")[0]


def _rounded(ms: float | None) -> float | None:
    return None if ms is None else round(ms, 1)


def _firmware(facts: Mapping[str, Any]) -> list[str]:
    """Return the different versions that the robot reported, sorted. A version with unusual characters is left
    out, because it may contain anything."""
    versions: set[str] = set()
    for name in FIRMWARE_FACTS:
        fact = facts.get(name, "")
        texts: Iterable[Any] = fact.values() if isinstance(fact, Mapping) else [fact]
        versions |= {str(text) for text in texts if _FIRMWARE.fullmatch(str(text))}
    return sorted(versions)


def encode(report: Report) -> bytes:
    """Return the text of a report's file."""
    return msgspec.json.format(msgspec.json.encode(report), indent=2) + b"\n"


def write(report: Report, path: Path) -> None:
    """Write a report. Raise ``OSError`` if that is not possible."""
    path.write_bytes(encode(report))


# -- read


def parse(data: bytes) -> Report:
    """Return the report in a file. It may have been made on a twin (``require_real``).

    Raises:
        BadReport: The data is no report of this project, or it is damaged.
    """
    if len(data) > LARGEST_BYTES:
        raise BadReport(f"it has {len(data)} bytes, so it is no drill report. {_MAKE_ONE}")
    try:
        fields = msgspec.json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadReport(
            f"it is no JSON ({error}). Copy the whole report, from the first brace to the last"
        ) from None
    if not isinstance(fields, dict) or fields.get("format") != FORMAT:
        raise BadReport(f'it is no drill report, because its "format" is not "{FORMAT}". {_MAKE_ONE}')
    if (version := fields.get("format_version")) != VERSION:
        raise BadReport(f"it has version {version!r} of the format, and {VERSION} is known here. {_MAKE_ONE}")
    try:
        report = msgspec.convert(fields, Report)
    except msgspec.ValidationError as error:
        raise BadReport(f"it is damaged: {error}. {_MAKE_ONE}") from None
    if problem := _foreign(report) or _implausible(report):
        raise BadReport(f"{problem}. {_MAKE_ONE}")
    return report


_MAKE_ONE = "Send the file that `strands-actors drill ROBOT --port PORT --report FILE` writes, unchanged"


def require_real(report: Report) -> None:
    """Check that a report is of a real robot.

    Raises:
        BadReport: The drill was made on a twin, or on a program of the same computer, which may be a twin.
    """
    if report.peer is Peer.TWIN:
        raise BadReport("it was made on a twin. Only a drill on a real robot counts: use --port instead of --twin")
    if report.peer is Peer.LOCAL:
        raise BadReport(
            f"the robot was reached by a {report.connection} of the same computer, so it may be a twin. If it is a "
            "real robot behind a program of its vendor, use the network address of the computer"
        )


def _foreign(report: Report) -> str:
    """Return why the robot or the driver is not of this package; empty if both are."""
    if report.robot not in list_native_drivers():
        return f"this package has no driver for the robot {report.robot[:40]!r}"
    if report.wire != _wire(report.driver) or report.driver not in _drivers_of(report.robot):
        return f"{report.driver[:80]!r} is no driver of {report.robot}"
    return ""


def _drivers_of(robot: str) -> set[str]:
    """Return the drivers of this package for a robot: the usual one, and those of its levels."""
    native = get_native_driver_class(robot)
    if native is None or not issubclass(native, Driver):
        return set()
    levels = [name for key, name in native.LEVELS.items() if key.partition(":")[0] == robot]
    return {name for name in (_name_of(native), *levels) if name.startswith(_PACKAGE)}


def _implausible(report: Report) -> str:
    """Return which value cannot come from a drill; empty if all can."""
    names = [step.step for step in report.steps]
    usual = names[:-1] if names[-1:] == [LOWERED] else names
    if usual != list(STEPS) and usual != [step for step in STEPS if step != OPTIONAL]:
        return f"its steps are {', '.join(names)[:80] or 'missing'}, and a drill has {', '.join(STEPS)}"
    if report.passed is not all(step.passed for step in report.steps):
        return '"passed" does not agree with its steps'
    for step in report.steps:
        times = [step.bound_ms, *([] if step.confirmed_ms is None else [step.confirmed_ms])]
        if not all(math.isfinite(ms) and 0 <= ms < 1e6 for ms in times):
            return f"the step {step.step} has a time that is impossible"
        if step.passed and step.confirmed_ms is None:
            return f"the step {step.step} was passed without a confirmation"
    if any(_FIRMWARE.fullmatch(text) is None for text in report.firmware):
        return "a version of its firmware has characters that no report has"
    if report.peer is not _peer(report.connection):
        return '"peer" does not agree with "connection"'
    try:
        day = date.fromisoformat(report.date)
    except ValueError:
        return f"its date is {report.date[:40]!r}, not YYYY-MM-DD"
    if day > datetime.now(UTC).date():
        return f"its date {report.date} has not come yet"
    return ""

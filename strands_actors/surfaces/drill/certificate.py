"""Certificates of drills: write them, find them, and check if a certificate allows motion now.

A certificate is valid for one configuration: the driver with its options, the port, the timing, the safe
states, and the code that stops the robot. After any change to these, even to one line of code, the
certificate no longer matches.
"""

from __future__ import annotations

import hashlib
import importlib
import re
import time
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec

from strands_actors import kernel as runtime
from strands_actors import supervisors
from strands_actors.caller.processes.run_directory import data_dir
from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.clock import NS

TWIN = "twin"
"""Stands for the port of a twin, which is different each time."""

_UNITS_S = {"m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}


class StepResult(msgspec.Struct, frozen=True):
    """The result of one step of a drill. Times are in milliseconds. None means that a value cannot be
    measured on this robot."""

    step: str
    passed: bool
    safe_state: str
    # Time from the fault to the first frame that brings the robot to the safe state. Only on a simulated robot,
    # which logs all frames.
    safe_ms: float | None
    confirmed_ms: float | None  # Time from the fault until every motor was read and was safe.
    bound_ms: float  # Longest allowed time from the fault to the first safe frame.
    setpoints_after: int | None  # Setpoints after the first safe frame. Only on a simulated robot.
    detail: str
    proves: tuple[str, ...] = ()


class Certificate(msgspec.Struct, frozen=True):
    """The certificate of a drill that was passed.

    Attributes:
        robot: The type of the robot.
        driver: The driver class, as ``module:class``.
        port: The port of the robot; ``TWIN`` for a simulated robot.
        config: The hash of the configuration (``config_of``).
        date: Date and time of the drill, in ISO 8601, UTC.
        versions: Versions of this package, Python and the system.
        results: The results of the steps. In the file they have the key ``figures``.
    """

    robot: str
    driver: str
    port: str
    config: str
    date: str
    versions: dict[str, str]
    results: list[StepResult] = msgspec.field(name="figures")


def config_of(driver_class: type[Driver], robot: str, port: str, options: Mapping[str, Any]) -> str:
    """Return the hash of a configuration.

    Args:
        driver_class: The driver.
        robot: The kind of the robot.
        port: The port in the form of the argument of ``Robot``; ``TWIN`` for any simulated robot.
        options: The options of the driver.
    """
    driver = driver_class(robot, "" if port == TWIN else port, options)
    left_out = {"tool_name", *driver_class.SECRETS}  # Leave out secrets: a password could be guessed from the hash.
    facts = {
        "driver": f"{driver_class.__module__}:{driver_class.__qualname__}",
        "robot": robot,
        "port": port,
        "options": {key: value for key, value in options.items() if key not in left_out},
        "timing": msgspec.to_builtins(driver.timing),
        "fallbacks": {str(reason): driver.fallbacks[reason] for reason in Reason},
        "bound_s": driver.bound_s,
        "code": _digest_of_code(driver_class),
    }
    return hashlib.sha256(msgspec.json.encode(facts, order="sorted")).hexdigest()[:16]


def _digest_of_code(driver_class: type[Driver]) -> str:
    """Return the hash of all code that stops the robot: the packages ``kernel`` and ``supervisors``, the driver's
    folder, and the code that drivers share."""
    digest = hashlib.sha256()
    for path in sorted(_code(driver_class)):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _code(driver_class: type[Driver]) -> Iterator[Path]:
    package, _, _ = driver_class.__module__.rpartition(".")
    own = importlib.import_module(package or driver_class.__module__).__file__
    for file in (runtime.__file__, supervisors.__file__, own):
        if file is not None and file.endswith("__init__.py"):
            yield from Path(file).parent.rglob("*.py")
            yield from (Path(file).parent.parent / "common").rglob("*.py")
        elif file is not None:
            yield Path(file)


# -- files


def path_of(robot: str, config: str) -> Path:
    return data_dir() / "drills" / f"{robot}-{config}.json"


def keep(certificate: Certificate) -> Path:
    """Write a certificate and return its path. Raise ``OSError`` if it cannot be written."""
    path = path_of(certificate.robot, certificate.config)
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".tmp")
    draft.write_bytes(msgspec.json.format(msgspec.json.encode(certificate), indent=2) + b"\n")
    draft.replace(path)
    return path


def revoke(robot: str, config: str) -> None:
    """Remove the certificate of a configuration, because a later drill has failed."""
    path_of(robot, config).unlink(missing_ok=True)


def find(robot: str, config: str) -> Certificate | None:
    """Return the certificate of a configuration. None if there is no certificate, or it cannot be read."""
    try:
        return msgspec.json.decode(path_of(robot, config).read_bytes(), type=Certificate)
    except (FileNotFoundError, msgspec.DecodeError):
        return None


# -- ``require_drill``


def parse_age_s(text: str) -> float:
    """Return an age such as ``"30d"`` in seconds. The units are m, h, d and w. Raise ``ValueError`` for a
    text of another form."""
    match = re.fullmatch(r"(\d+)\s*([mhdw])", str(text).strip())
    if match is None or int(match[1]) == 0:
        raise ValueError(f"require_drill is {text!r}. Give an age such as '12h', '30d' or '8w'")
    return float(int(match[1]) * _UNITS_S[match[2]])


def clause(
    driver_class: type[Driver], robot: str, port: str, options: Mapping[str, Any], max_age_s: float
) -> dict[str, Any]:
    """Return the condition under which the robot's gate (the actor that checks commands) accepts motion.

    Args:
        driver_class: The driver.
        robot: The kind of the robot.
        port: The port; ``TWIN`` for a twin.
        options: The options of the driver.
        max_age_s: Largest age of a certificate, in seconds.

    Returns:
        A dict. ``until_ns`` is the time until which motion is accepted, in nanoseconds of CLOCK_MONOTONIC,
        and 0 if no motion is accepted. ``reason`` and ``remedy`` are the text of the refusal afterwards.
    """
    config = config_of(driver_class, robot, port, options)
    how = f"strands-actors drill {robot} {'--twin' if port == TWIN else f'--port {port}'}"
    certificate = find(robot, config)
    if certificate is None:
        reason, until_ns = "no drill was passed with this robot, configuration and code", 0
    else:
        ends = datetime.fromisoformat(certificate.date) + timedelta(seconds=max_age_s)
        left_s = (ends - datetime.now(UTC)).total_seconds()
        reason = f"the drill of {certificate.date[:10]} is older than {max_age_s / 86400:g} days"
        until_ns = time.monotonic_ns() + round(left_s * NS) if left_s > 0 else 0
    return {"until_ns": until_ns, "reason": reason, "remedy": f"run `{how}`, then connect again"}

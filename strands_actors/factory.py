"""From the arguments of ``Robot(...)`` to a plan, or to a refusal that says what would be accepted."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from typing import Any

from .drill.certificate import parse_age_s
from .drivers import canonical_name, get_native_driver_class, list_driver_coverage, list_native_drivers
from .runtime.contract import Driver

MODES = ("real",)
_TOOL_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}\Z")


@dataclass(frozen=True)
class Plan:
    """What to start, checked."""

    robot: str
    tool_name: str
    driver_class: type[Driver]
    port: str
    transport: str | None
    options: dict[str, Any]
    drill_age_s: float | None = None
    """No motion without a stop drill that is younger."""


def plan(
    name: str,
    mode: str = "sim",
    *,
    port: str | None = None,
    transport: str | None = None,
    tool_name: str | None = None,
    require_drill: str | None = None,
    **options: Any,
) -> Plan:
    """Raise ``ValueError`` for names, values and unknown keywords."""
    if str(mode).lower() not in MODES:
        raise ValueError(
            f"Robot: mode {mode!r} is not available in this version. use mode='real', "
            "with port=... or transport='twin'"
        )
    robot = canonical_name(name)
    driver_class = _driver_class(name, robot)
    chosen = robot if tool_name is None else tool_name
    if not _TOOL_NAME.match(chosen):
        raise ValueError(f"Robot: tool_name is {chosen!r}. use 1 to 64 of A-Z a-z 0-9 _ -")
    if transport is not None and transport not in driver_class.TRANSPORTS:
        offered = ", ".join(driver_class.TRANSPORTS)
        raise ValueError(f"Robot: {driver_class.__name__} has no transport {transport!r}. it offers {offered}")
    _check_keywords(driver_class, options)
    if transport is None and port is None:
        raise ValueError(_missing_port(robot, driver_class))
    resolved = driver_class.resolve(robot, {**options, "tool_name": chosen})
    drill_age_s = None if require_drill is None else parse_age_s(require_drill)
    return Plan(robot, chosen, driver_class, port or "", transport, resolved, drill_age_s)


def _driver_class(name: str, robot: str) -> type[Driver]:
    driver_class = get_native_driver_class(robot)
    if driver_class is not None and issubclass(driver_class, Driver):
        return driver_class
    if name.endswith("_leader"):
        raise ValueError(
            f"Robot: {name} is a teleoperator. use Teleoperator({name!r}, port=...) and attach it to a follower"
        )
    known = list_driver_coverage()
    if robot in known:
        raise ValueError(f"Robot: {name} has no native driver. these have one: {', '.join(list_native_drivers())}")
    close = difflib.get_close_matches(name, known, n=3)
    hint = f" Did you mean: {', '.join(close)}?" if close else ""
    raise ValueError(
        f"Robot: {name!r} is not known.{hint} strands_actors.drivers.list_driver_coverage() lists all robots"
    )


def _check_keywords(driver_class: type[Driver], options: dict[str, Any]) -> None:
    accepted = sorted({"port", "transport", "tool_name", "require_drill", *driver_class.OPTIONS})
    for keyword in options:
        if keyword not in accepted:
            close = difflib.get_close_matches(keyword, accepted, n=1)
            hint = f" ({keyword!r} -> {close[0]!r}?)" if close else ""
            raise ValueError(
                f"Robot: {driver_class.__name__} takes no {keyword!r}{hint}. it takes {', '.join(accepted)}"
            )


def _missing_port(robot: str, driver_class: type[Driver]) -> str:
    if driver_class.PORT_KIND != "serial":
        return f"Robot: {robot} needs 'port', its address: Robot({robot!r}, mode='real', port='192.0.2.10')"
    from serial.tools import list_ports

    found = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
    return (
        f"Robot: {robot} needs 'port': Robot({robot!r}, mode='real', port='/dev/ttyACM0'). "
        f"serial devices here: {found} (a path is not an identity: check which robot is behind it)"
    )

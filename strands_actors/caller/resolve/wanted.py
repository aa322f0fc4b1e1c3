"""Read and check the arguments of ``Robot(...)``, find the driver's class, and resolve ``mode="auto"``."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.contract.shown import closest, shown
from strands_actors.drivers import (
    MODEL,
    PARTS,
    ROS2,
    ROS2_DRIVER,
    canonical_name,
    constructor_keywords,
    driver_name,
    get_lerobot_class,
    get_native_driver_class,
    list_driver_coverage,
    list_native_drivers,
    register_own_table,
    resolve_driver,
)
from strands_actors.kernel.processes.limits import PolicyLimits, limits_of
from strands_actors.parts.tables import TABLES
from strands_actors.supervisors.gate.messages import MAX_LIFETIME_S
from strands_actors.surfaces.drill.certificate import parse_age_s
from strands_actors.surfaces.mesh.config import MeshConfig

from .simulated import Scene, check_backend

MODES = ("sim", "real", "auto")
MODE_VARIABLE = "STRANDS_ROBOT_MODE"
"""Environment variable with the mode (``sim`` or ``real``) that ``mode="auto"`` selects on this computer. Other
modes ignore it.
"""
_log = logging.getLogger("strands_actors")
_TOOL_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}\Z")
TOOL_NAMES = "1 to 64 of A-Z a-z 0-9 _ -"


def is_tool_name(name: str) -> bool:
    return _TOOL_NAME.match(name) is not None


@dataclass(frozen=True)
class RobotArguments:
    """The checked arguments of ``Robot(...)``, except ``approve``, ``guarded`` and ``arm``."""

    name: str
    robot: str
    mode: str
    tool_name: str
    # If the mode is "real", the port is a text or None.
    port: Any
    transport: str | None
    sim: Any
    cameras: Any
    data_config: Any
    mesh: MeshConfig
    drill_age_s: float | None
    host_address: str | None
    lifetime_s: float | None
    policy_limits: PolicyLimits
    scene: Scene
    options: dict[str, Any] = field(repr=False)
    spelled: Mapping[str, str] = field(default_factory=dict)
    """Options that the user gave by another name. The keys are the driver's names, the values are the other
    names.
    """

    def body_options(self, driver_class: type[Driver]) -> dict[str, Any]:
        """Return the given options that describe the robot's body, which a simulation has as well."""
        return {key: value for key, value in self.options.items() if key in driver_class.TWIN_OPTIONS}

    def hardware_keywords(self) -> dict[str, Any]:
        """Return the given arguments that only a real robot uses."""
        own = {"port": self.port, "transport": self.transport, "sim": self.sim}
        own |= {"require_drill": self.drill_age_s, "at": self.host_address}
        return {key: value for key, value in own.items() if value is not None} | self.options


def read(
    name: str,
    mode: str,
    *,
    driver: str = "auto",
    port: str | os.PathLike[str] | None = None,
    transport: str | None = None,
    sim: Any = None,
    id: str | None = None,  # the name of this parameter in LeRobot
    tool_name: str | None = None,
    peer_id: str | None = None,
    cameras: Any = None,
    data_config: Any = None,
    mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None,
    at: str | None = None,
    lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | PolicyLimits | None = None,
    backend: str = "mujoco",
    urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None,
    gated: bool = True,
    onboard: str | os.PathLike[str] | None = None,
    **options: Any,
) -> tuple[RobotArguments, type[Any]]:
    """Return the checked arguments, and the driver's class.

    Raises:
        ValueError: A name, a value or a keyword is wrong.
        TypeError: A value has the wrong type.
        ImportError: The package of the ``backend`` is not installed.
    """
    chosen_mode = str(mode).strip().lower()
    if chosen_mode not in MODES:
        raise ValueError(f"Robot: mode is {mode!r}. Use {', '.join(map(repr, MODES))} (upper or lower case)")
    robot = canonical_name(name)
    scene = Scene(backend, urdf_path, position, orientation, keyframe, gated, onboard)
    if not isinstance(gated, bool):
        raise TypeError(
            f"Robot: gated is {shown(gated)}. Give True, or False to let targets exceed the ranges of joints"
        )
    check_backend(backend)
    register_own_table(robot, options)
    if driver == "auto" and _is_of_parts(robot, chosen_mode, transport, options):
        driver_class = load(PARTS)
    else:
        driver_class = _driver_class(name, robot, driver, scene.model(robot) is not None and chosen_mode != "real")
    tool_name = _id(robot, {"id": id, "tool_name": tool_name, "peer_id": peer_id})
    _check_keywords(driver_class, options)
    options, spelled = _spelled(driver_class, options)
    if mesh is False:
        mesh = MeshConfig()
    # In strands-robots True asks for a mesh. Every robot of this package is on a mesh anyway.
    if mesh is True:
        mesh = None
    if mesh is not None and not isinstance(mesh, MeshConfig):
        raise TypeError(
            f"Robot: mesh is {mesh!r}. Give MeshConfig(listen=...) to let other hosts reach the robot, or False"
        )
    if mesh is None:
        mesh = MeshConfig.from_environment()
    if at is not None:
        if not isinstance(at, str):
            raise TypeError(
                f"Robot: at is {shown(at)}. Give the address of the robot's host: 'tls/arm.example:7447'"
            )
        mesh = msgspec.structs.replace(mesh, connect=at, listen=())
    mesh.check()
    if lifetime is not None and not 0 < lifetime <= MAX_LIFETIME_S:
        raise ValueError(f"Robot: lifetime is {lifetime!r}. Give seconds, above 0 and at most {MAX_LIFETIME_S:g}")
    drill_age_s = None if require_drill is None else parse_age_s(require_drill)
    if chosen_mode == "auto":
        port, chosen_mode = _look_around(driver_class, port, transport) if at is None else (port, "real")
    port_text = _port(driver_class, port) if chosen_mode == "real" else port
    if chosen_mode == "real" and transport == "serial" and is_serial(driver_class):
        # In strands-robots ``transport="serial"`` means that a port is used.
        transport = None
    return (
        RobotArguments(
            name,
            robot,
            chosen_mode,
            tool_name,
            port_text,
            transport,
            sim,
            cameras,
            data_config,
            mesh,
            drill_age_s,
            at,
            lifetime,
            limits_of(policy_limits),
            scene,
            options,
            spelled,
        ),
        driver_class,
    )


def _id(robot: str, spellings: Mapping[str, Any]) -> str:
    """Return the id of the robot, from the keyword that was given.

    strands-robots names it ``tool_name`` (of the tool for agents), and ``peer_id`` (on the mesh).
    """
    given = {keyword: value for keyword, value in spellings.items() if value is not None}
    keyword, chosen = next(iter(given.items()), ("id", robot))
    for other, value in given.items():
        if value != chosen:
            raise ValueError(f"Robot: {keyword} and {other} are both given, and mean the same. Give one of them")
    if not isinstance(chosen, str) or not is_tool_name(chosen):
        raise ValueError(f"Robot: {keyword} is {chosen!r}. Use {TOOL_NAMES}")
    return chosen


def _is_of_parts(robot: str, mode: str, transport: str | None, options: Mapping[str, Any]) -> bool:
    """Return True if the robot is made of other robots here. LeRobot has a class for some of them, too, which the
    keywords of LeRobot select."""
    if options.get("parts") is not None:
        return robot in TABLES or robot not in list_driver_coverage()
    return robot in TABLES and (mode != "real" or transport is not None)


def _driver_class(name: str, robot: str, driver: str, has_model: bool) -> type[Any]:
    if driver == ROS2_DRIVER:
        return load(ROS2)  # type: ignore[no-any-return]  # by its name
    coverage = list_driver_coverage()
    if has_model and ("strands" not in coverage.get(robot, ()) or get_native_driver_class(robot) is None):
        if driver not in ("auto", "strands"):
            # This raises an error for an unknown ``driver``.
            resolve_driver(name, driver)
        return load(MODEL)  # type: ignore[no-any-return]  # by its name
    if robot not in coverage:
        raise ValueError(_unknown(name, coverage))
    if resolve_driver(name, driver) == "strands":
        driver_class = get_native_driver_class(robot)
        assert driver_class is not None
        return driver_class
    if driver == "auto" and "lerobot" not in coverage[robot]:
        native = ", ".join(list_native_drivers())
        raise ValueError(
            f"Robot: {name} has no native driver. To simulate it, register a model: register_robot({robot!r}, "
            f"model_xml=...). These robots have a driver: {native}"
        )
    return get_lerobot_class(name)


def _unknown(name: str, robot_names: Iterable[str]) -> str:
    if name.endswith("_leader"):
        follower = canonical_name(name.removesuffix("_leader"))
        its = f" its follower is Robot({follower!r}, mode='real', port=...)" if follower in robot_names else ""
        return (
            f"Robot: {name} is a teleoperator. Use Teleoperator({name!r}, port=...) and arm.teleoperate(it).{its}"
        )
    close = closest(name, robot_names, 3)
    hint = f" Did you mean: {', '.join(close)}?" if close else ""
    return f"Robot: {shown(name)} is not known.{hint} strands_actors.list_robots() has them all"


def _check_keywords(driver_class: type[Any], options: Mapping[str, Any]) -> None:
    accepted = constructor_keywords(driver_class)
    if "**" in accepted:
        return
    for keyword in options:
        if keyword not in accepted:
            close = closest(keyword, accepted)
            hint = f" ({keyword!r} -> {close[0]!r}?)" if close else ""
            raise ValueError(
                f"Robot: {driver_name(driver_class)} takes no {keyword!r}{hint}. It takes {', '.join(accepted)}"
            )


def _spelled(driver_class: type[Any], options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the options by the driver's names, and the other names by which the user gave some of them."""
    others: Mapping[str, str] = getattr(driver_class, "SPELLINGS", {})
    renamed: dict[str, Any] = {}
    for keyword, value in options.items():
        own = others.get(keyword, keyword)
        if own in renamed:
            duplicate = next(name for name in options if others.get(name, name) == own and name != keyword)
            raise ValueError(
                f"Robot: {duplicate} and {keyword} are both given, and mean the same. Give one of them"
            )
        renamed[own] = value
    return renamed, {others[keyword]: keyword for keyword in options if keyword in others}


def _port(driver_class: type[Any], port: Any) -> str | None:
    """Return the port as text; None if it is None or blank. Raise ``TypeError`` or ``ValueError``."""
    if port is None:
        return None
    if not isinstance(port, str | os.PathLike) or not isinstance(text := os.fspath(port), str):
        raise TypeError(f"Robot: port is {port!r}. Give a path or an address, as text")
    if not text.strip():
        return None
    if any(letter.isspace() for letter in text) and getattr(driver_class, "PORT_KIND", None) == "address":
        raise ValueError(f"Robot: port is {text!r}. Give an address, without spaces")
    return text


def is_serial(driver_class: type[Any]) -> bool:
    """Return True if the driver's port is serial."""
    return issubclass(driver_class, Driver) and getattr(driver_class, "PORT_KIND", None) == "serial"


def _look_around(
    driver_class: type[Any], port: str | os.PathLike[str] | None, transport: str | None
) -> tuple[str | os.PathLike[str] | None, str]:
    """Return port and mode for ``mode="auto"``.

    A given port or transport decides. Without them the environment variable decides, then the adapters that are
    plugged in.
    """
    if port is not None or transport is not None:
        return port, "real"
    mode = _mode_of_environment()
    if mode == "sim":
        return None, "sim"
    devices = adapters(driver_class)
    if mode == "real":
        return devices[0] if len(devices) == 1 else None, "real"
    return (devices[0], "real") if len(devices) == 1 else (None, "sim")


def _mode_of_environment() -> str:
    """Return the value of ``STRANDS_ROBOT_MODE``, ``sim`` or ``real``; empty if it is not set."""
    word = os.environ.get(MODE_VARIABLE, "").strip().lower()
    if word in ("", "auto"):
        return ""
    if word not in MODES:
        _log.warning("%s is %r, and is ignored. Use %s", MODE_VARIABLE, word, ", ".join(map(repr, MODES)))
        return ""
    return word


def adapters(driver_class: type[Any]) -> list[str]:
    """Return the serial devices with a USB adapter of the driver's kind (``Driver.USB_IDS``)."""
    if getattr(driver_class, "PORT_KIND", None) != "serial":
        return []
    from serial.tools import list_ports

    usb_ids = getattr(driver_class, "USB_IDS", ())
    return sorted(
        port.device
        for port in list_ports.comports()
        if (getattr(port, "vid", None), getattr(port, "pid", None)) in usb_ids
    )

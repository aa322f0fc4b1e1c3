"""Read the file of a host, and find all its faults at once.

    [host]
    metrics = "127.0.0.1:9464"

    [robot.left]
    type = "so101"
    port = "/dev/serial/by-id/usb-1a86_USB_Single_Serial_5A68-if00"

The name of a table is the name of the robot. Its keys are the keywords of ``Robot``. Paths in the file are relative
to the file. Nothing is started here, and no robot is asked.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec

from strands_actors.caller.processes.port_claim import port_identity
from strands_actors.caller.resolve.wanted import TOOL_NAMES, is_tool_name
from strands_actors.contract.loading import load
from strands_actors.contract.shown import closest, shown
from strands_actors.kernel.channels.ros2.names import problem_of
from strands_actors.surfaces.agents.approval import APPROVE_S, approval_of
from strands_actors.surfaces.mesh.config import MeshConfig
from strands_actors.surfaces.metrics.stops import problem_of_collector

from .fleet import METRICS, BadFleet, Fault, Fleet, RobotSpec
from .toml_lines import lines_of

MAX_BYTES = 256 * 1024
HOST_KEYS = ("metrics", "ros2", "traces", "web")
WEB_PORT = 8390
HIGHEST_PORT = 65535
OWN_KEYS = ("type", "adapter")
"""Keys of a robot's table that are no keywords of ``Robot``."""
HANDLE_KEYS = ("arm", "guarded", "approve", "approve_within_s")
"""Keywords of ``Robot`` that hold for the handles of scripts that attach themselves."""
NAME_KEYS = ("id", "tool_name", "peer_id")
NOT_HERE = {
    "at": "a host keeps the robots of its own computer. Run a host there",
    "attach": "this file is where other programs attach themselves to",
    "sim": "it is an object of a script. For a simulation, leave out port and transport",
}
"""Keywords of ``Robot`` that cannot stand in the file, with the reason."""
MOST_FAULTS = 20
"""Most faults of one robot's table that are looked for."""


class Ros2(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The options of the ROS 2 bridge, as ``strands-actors ros2`` has them."""

    domain: Annotated[int, msgspec.Meta(ge=0, le=232)] = 0
    namespace: str = ""
    router: str = "tcp/localhost:7447"
    humble: bool = False
    allow_motion: bool = False


ROS2_KEYS = ", ".join(Ros2.__struct_fields__)


def read_fleet(path: Path) -> Fleet:
    """Read and check a file.

    Raises:
        BadFleet: The file has faults.
    """
    try:
        data = path.read_bytes()
        if len(data) > MAX_BYTES:
            raise BadFleet(path, [Fault(0, f"it has {len(data)} bytes. At most {MAX_BYTES} are read")])
        text = data.decode()
        document = tomllib.loads(text)
    except OSError as error:
        raise BadFleet(path, [Fault(0, f"it cannot be read: {error.strerror}")]) from None
    except UnicodeDecodeError as error:
        raise BadFleet(path, [Fault(data[: error.start].count(b"\n") + 1, "this is not UTF-8 text")]) from None
    except tomllib.TOMLDecodeError as error:
        raise BadFleet(path, [_syntax(str(error))]) from None
    return _Reader(path, document, lines_of(text)).read()


def _syntax(text: str) -> Fault:
    """Return the fault of a file that is no TOML. The line stands at the end of tomllib's message."""
    reason, _, place = text.rpartition(" (at line ")
    number = place.partition(",")[0]
    return Fault(int(number), reason) if number.isdigit() else Fault(0, text)


class _Reader:
    """Check one document."""

    def __init__(self, path: Path, document: dict[str, Any], lines: Mapping[tuple[str, ...], int]) -> None:
        self._path = path
        self._document = document
        self._lines = lines
        self._faults: list[Fault] = []

    def read(self) -> Fleet:
        for key in self._document:
            if key not in ("host", "robot"):
                self._fault(
                    (key,), f"unknown key {shown(key)}{_hint(key, ('host', 'robot'))}. Use [host], [robot.NAME]"
                )
        host = self._table(("host",), self._document.get("host", {}))
        for key in host:
            if key not in HOST_KEYS:
                self._fault(
                    ("host", key), f"unknown key {shown(key)}{_hint(key, HOST_KEYS)}. Use {', '.join(HOST_KEYS)}"
                )
        services = self._services(host)
        tables = self._table(("robot",), self._document.get("robot", {}))
        if not self._document.get("robot"):
            self._fault(("robot",), "it names no robot. Add a table [robot.NAME] with type = ...")
        robots: dict[str, RobotSpec] = {}
        lines_of_names: dict[str, int] = {}
        ports: dict[str, str] = {}
        for name, value in tables.items():
            spec = self._robot(name, self._table(("robot", name), value))
            if spec is None:
                continue
            line = self._lines.get(("robot", name), 0)
            if spec.name in robots:
                where = f"line {lines_of_names[spec.name]}"
                self._fault(self._name_key(name), f"two robots have the name {spec.name}. The other is in {where}")
                continue
            robots[spec.name], lines_of_names[spec.name] = spec, line
            self._check_port(name, spec, ports)
        if self._faults:
            raise BadFleet(self._path, self._faults)
        return Fleet(self._path, robots, services)

    def _fault(self, path: tuple[str, ...], text: str) -> None:
        while path and path not in self._lines:
            path = path[:-1]
        self._faults.append(Fault(self._lines.get(path, 0), text))

    def _table(self, path: tuple[str, ...], value: Any) -> dict[str, Any]:
        if isinstance(value, dict):
            return value
        self._fault(path, f"{'.'.join(path)} is {shown(value)}. Give a table")
        return {}

    def _services(self, host: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """Return the arguments of each service that the host runs."""
        services: dict[str, dict[str, Any]] = {}
        if (metrics := host.get("metrics", METRICS)) is not False:
            address, colon, port = metrics.rpartition(":") if isinstance(metrics, str) else ("", "", "")
            if not colon or not address or not port.isdecimal() or int(port) > HIGHEST_PORT:
                self._fault(("host", "metrics"), f'metrics is {shown(metrics)}. Give "{METRICS}", or false')
            else:
                services["metrics"] = {"host": address, "port": int(port), "traces": ""}
        if (traces := host.get("traces", "")) != "":
            problem = problem_of_collector(traces) if isinstance(traces, str) else f"{shown(traces)} is no text"
            if problem or "metrics" not in services:
                self._fault(("host", "traces"), f"traces: {problem or 'the metrics send them. Give metrics, too'}")
            else:
                services["metrics"]["traces"] = traces
        if (web := host.get("web", False)) is not False:
            port_of_web = WEB_PORT if web is True else web
            if not isinstance(port_of_web, int) or not 0 <= port_of_web < HIGHEST_PORT:
                self._fault(("host", "web"), f"web is {shown(web)}. Give the port of the console, true, or false")
            else:
                services["web"] = {"port": port_of_web}
        if (ros2 := host.get("ros2", False)) is not False:
            try:
                options = msgspec.convert({} if ros2 is True else ros2, Ros2)
            except msgspec.ValidationError as error:
                self._fault(("host", "ros2"), f"ros2: {error}. Give true, false, or a table with {ROS2_KEYS}")
            else:
                if problem := problem_of(options.namespace, options.router):
                    self._fault(("host", "ros2"), f"ros2: {problem}")
                services["ros2"] = {"options": list(msgspec.structs.astuple(options))}
        return services

    def _name_key(self, table: str) -> tuple[str, ...]:
        given = [key for key in NAME_KEYS if key in self._document["robot"][table]]
        return ("robot", table, *given[:1])

    # -- one robot

    def _robot(self, table: str, values: dict[str, Any]) -> RobotSpec | None:
        """Return a robot. If its table has faults, note them all, and return what is known of the robot for the
        comparison with the others; None if that is nothing."""
        place = ("robot", table)
        kind = values.get("type")
        if not isinstance(kind, str):
            about = "type is missing" if kind is None else f"type is {shown(kind)}"
            self._fault((*place, "type"), f'{table}: {about}. Give the type of the robot, such as type = "so101"')
            return None
        name = next((values[key] for key in NAME_KEYS if isinstance(values.get(key), str)), table)
        if not is_tool_name(name):
            self._fault(self._name_key(table), f"the name {shown(name)} cannot be used. Use {TOOL_NAMES}")
            return None
        for key, reason in NOT_HERE.items():
            if key in values:
                self._fault((*place, key), f"{name}: {key} cannot stand in this file: {reason}")
        adapter = values.get("adapter", "")
        if not isinstance(adapter, str):
            self._fault(
                (*place, "adapter"), f"{name}: adapter is {shown(adapter)}. Give its serial number, as text"
            )
            adapter = ""
        keywords = {
            key: self._resolved((*place, key), key, value)
            for key, value in values.items()
            if key not in (*OWN_KEYS, *HANDLE_KEYS, *NOT_HERE)
        }
        spec = RobotSpec(name, kind, keywords, self._handle(place, values), adapter)
        return self._without_faults(place, spec)

    def _resolved(self, place: tuple[str, ...], key: str, value: Any) -> Any:
        """Return a value with its path relative to the file, or the mesh that it stands for."""
        if key in ("urdf_path", "onboard") and isinstance(value, str):
            return os.fspath(self._path.parent / Path(value).expanduser())
        if key != "mesh" or isinstance(value, bool):
            return value
        try:
            if isinstance(value, str):
                return MeshConfig.load(self._path.parent / value)
            config = msgspec.convert(value, MeshConfig)
            if config.tls is not None:
                paths = msgspec.structs.asdict(config.tls)
                tls = msgspec.structs.replace(
                    config.tls, **{name: self._file((*place, "tls", name), path) for name, path in paths.items()}
                )
                config = msgspec.structs.replace(config, tls=tls)
            config.check()
        except (ValueError, OSError) as error:
            self._fault(place, str(error))
            return False
        return config

    def _file(self, place: tuple[str, ...], value: str) -> str:
        path = self._path.parent / Path(value).expanduser()
        if not path.is_file():
            self._fault(place, f"{place[-1]}: there is no file {path}")
        return os.fspath(path)

    def _handle(self, place: tuple[str, ...], values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the settings for the handles of scripts that attach themselves."""
        settings: dict[str, Any] = {"arm": True, "guarded": [], "approve": "", "approve_within_s": None}
        checks: dict[str, tuple[Callable[[Any], bool], str]] = {
            "arm": (lambda value: isinstance(value, bool), "Give true or false"),
            "guarded": (
                lambda value: isinstance(value, list) and all(isinstance(each, str) for each in value),
                "Give an array of names of verbs",
            ),
            "approve": (_is_importable, 'Give "module:function" that can be imported'),
            "approve_within_s": (
                lambda value: isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= 3600,
                "Give seconds, above 0 and at most 3600",
            ),
        }
        for key, (is_right, remedy) in checks.items():
            if key in values and is_right(values[key]):
                settings[key] = values[key]
            elif key in values:
                self._fault((*place, key), f"{place[-1]}: {key} is {shown(values[key])}. {remedy}")
        return settings

    def _without_faults(self, place: tuple[str, ...], spec: RobotSpec) -> RobotSpec | None:
        """Return the robot without the keywords that ``Robot`` refuses, and note a fault for each of them.

        ``Robot`` names one fault at a time. The keyword that caused it is found by leaving keywords out. Without
        the right one, the robot is accepted, or another fault is named.
        """
        for _ in range(MOST_FAULTS):
            problem = _problem(spec)
            if problem is None:
                return self._guards(place, spec)
            keys = sorted(spec.keywords, key=lambda key: key not in problem)
            trials = {key: _problem(_without(spec, key)) for key in keys}
            culprit = next((key for key, after in trials.items() if after is None), None) or next(
                (key for key, after in trials.items() if after != problem and key in problem), None
            )
            self._fault((*place, culprit or "type"), f"{spec.name}: {problem.removeprefix('Robot: ')}")
            if culprit is None:
                return None
            spec = _without(spec, culprit)
        return None

    def _guards(self, place: tuple[str, ...], spec: RobotSpec) -> RobotSpec:
        """Check the names that need approval, which depend on the driver."""
        try:
            approval_of(spec.plan().driver_class, spec.handle["guarded"], None, APPROVE_S)
        except (TypeError, ValueError) as error:
            self._fault((*place, "guarded"), f"{spec.name}: {error}")
        return spec

    def _check_port(self, table: str, spec: RobotSpec, ports: dict[str, str]) -> None:
        """Note a fault if another robot has the same port."""
        made = spec.plan()
        if made.twin_process is not None:
            return
        other = ports.setdefault(port_identity(made), spec.name)
        if other != spec.name:
            port = made.port or f"{spec.type} without a port"
            self._fault(
                ("robot", table, "port"), f"{spec.name}: {other} has the same port ({port}). Give each its own"
            )


def _without(spec: RobotSpec, key: str) -> RobotSpec:
    return replace(spec, keywords={name: value for name, value in spec.keywords.items() if name != key})


def _problem(spec: RobotSpec) -> str | None:
    """Return why ``Robot`` refuses the keywords; None if it accepts them."""
    try:
        spec.plan()
    except (TypeError, ValueError, ImportError) as error:
        return str(error)
    return None


def _is_importable(value: Any) -> bool:
    try:
        return isinstance(value, str) and ":" in value and callable(load(value))
    except (ImportError, AttributeError, ValueError):
        return False


def _hint(key: str, names: tuple[str, ...]) -> str:
    close = closest(key, names)
    return f" ({close[0]!r}?)" if close else ""

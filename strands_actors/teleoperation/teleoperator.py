"""``Teleoperator(...)`` describes a leader for a robot.

This module does not open any hardware. The process of the teleoperation does.
"""

from __future__ import annotations

import difflib
import inspect
import itertools
import os
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from strands_actors.caller.processes.run_directory import run_dir
from strands_actors.caller.processes.twin_process import TwinProcess, TwinProcessDown
from strands_actors.caller.session.portal import portal
from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Driver
from strands_actors.contract.extras import missing
from strands_actors.contract.loading import load
from strands_actors.contract.plain_numbers import as_python
from strands_actors.contract.shown import shown
from strands_actors.drivers import leader_name, list_leaders
from strands_actors.supervisors.loading import build_driver, describe_driver

from . import lerobot
from .machine import Kind

KEYBOARD = "keyboard"
PHONE = "phone"
PAGES = ("page", "gamepad", PHONE)
OPERATED = (KEYBOARD, *PAGES)
"""Leaders that are an operator with keys or sticks."""

_numbers = itertools.count(1)

HAND = "strands_actors.drivers.sim.world:move_by_hand"


class Teleoperator:
    """A leader for a robot. Nothing is opened before ``arm.teleoperate(leader)``.

    The name selects the kind:

        ``so101_leader``         a leader arm, at ``port`` or simulated
        ``keyboard``             keys, which a program reports by ``arm.operate()``
        ``page``, ``gamepad``, ``phone``  a web page for touch or a gamepad, at the URL ``address``
        ``module:Class``         any object with ``get_action()``, with ``options`` as keyword arguments
        ``lerobot:TYPE``         LeRobot's teleoperator of this type, with the fields of its config

    Args:
        name: Name of the leader (see above).
        port: Serial device of a leader arm.
        transport: ``"twin"`` for a simulated leader arm, in place of a port.
        id: Name under which LeRobot keeps the arm's calibration.
        relative: True: the robot repeats the leader's changes since the dead-man was pressed. False: the
            robot goes to the leader's pose.
        options: Options of the leader. A page has the option ``listen``, the address at which it is served.

    Raises:
        ValueError: The name or an option is unknown. The text has the accepted ones.
        TypeError: A value has the wrong type, or this leader does not take the keyword.

    Example:
        with Teleoperator("so101_leader", port="/dev/ttyACM1") as leader:
            arm.teleoperate(leader, duration=60.0)
    """

    def __init__(
        self,
        name: str,
        *,
        port: str | None = None,
        transport: str | None = None,
        id: str | None = None,  # the name of this parameter in LeRobot
        relative: bool = False,
        **options: Any,
    ) -> None:
        # The text "no" would count as true, so only a bool is accepted.
        if not isinstance(relative, bool):
            raise TypeError(f"Teleoperator: relative is {shown(relative)}. Give True or False")
        self._twin: TwinProcess | None = None
        self._hand: dict[str, float] = {}
        self._address_file: Path | None = None
        self._listen = "127.0.0.1", 0
        self._options = options
        self._driver: Driver | None = None
        self._driver_class: type[Driver] | None = None
        self.name = name
        self.kind = Kind.RELATIVE if relative else Kind.ABSOLUTE
        self._port = port
        leader = leader_name(name) if isinstance(name, str) else None
        if leader is not None:
            self._lead(leader, transport, id)
        elif name in OPERATED or (isinstance(name, str) and ":" in name):
            arguments = {
                "port": None if ":" in name else port,
                "transport": transport,
                "id": None if ":" in name else id,
            }
            if wrong := [key for key, value in arguments.items() if value is not None]:
                raise TypeError(f"Teleoperator: {name} has no {', '.join(wrong)}. Leave it out")
            if name.startswith(lerobot.PREFIX) and not lerobot.is_installed():
                raise ValueError(
                    f"{name} needs lerobot, which is not installed. Run pip install 'strands-actors[lerobot]'"
                )
            if ":" in name:
                own = {"port": port, "id": id}
                self._options = {**{key: value for key, value in own.items() if value is not None}, **options}
            else:
                self.kind = Kind.JOG
                if name in PAGES:
                    if reason := missing("web", f"the leader {name}"):
                        raise ValueError(f"Teleoperator: {reason}")
                    self._listen = parse_listen_address(options.pop("listen", ""))
                if options or relative:
                    raise TypeError(
                        f"Teleoperator: {name} takes no {', '.join(options) or 'relative'}. Leave that out"
                    )
        else:
            raise ValueError(_unknown(name))

    def _lead(self, leader: str, transport: str | None, robot_id: str | None) -> None:
        self.name = leader
        driver_class = list_leaders()[leader]
        if transport not in (None, "twin"):
            raise ValueError(f"Teleoperator: {leader} has no transport {transport!r}. It offers twin")
        for argument, value, example in (("port", self._port, "'/dev/ttyACM1'"), ("id", robot_id, "'left'")):
            if value is not None and not (isinstance(value, str) and value.strip()):
                raise TypeError(f"Teleoperator: {argument} is {shown(value)}. Give it as text: {example}")
        if (self._port is None) == (transport is None):
            raise ValueError(
                f"Teleoperator: give {leader} one of port= and transport='twin': "
                f"Teleoperator({leader!r}, port='/dev/ttyACM1')"
            )
        if unknown := [key for key in self._options if key not in driver_class.OPTIONS]:
            accepted = ", ".join(driver_class.OPTIONS)
            raise ValueError(f"Teleoperator: {leader} takes no {', '.join(unknown)}. It takes {accepted}")
        options = self._options if transport is not None else {**self._options, "tool_name": robot_id or leader}
        self._options = driver_class.resolve(leader, options)
        self._driver_class = driver_class
        self._driver = build_driver(driver_class, leader, self._port or "", self._options)
        if self._port is not None:
            try:
                self._driver.check_port()
            except ValueError as refusal:
                raise ValueError(f"Teleoperator: {leader}: {refusal}") from None
        if transport is not None:
            self._twin = TwinProcess(driver_class.TWIN, leader, has_control=True)

    @property
    def is_arm(self) -> bool:
        return self._driver is not None

    @property
    def driver(self) -> Driver:
        """Return the driver of a leader arm. It describes axes and units. Raise ``TypeError`` if the leader is not
        an arm.
        """
        if self._driver is None:
            raise TypeError(f"{self.name} is not a leader arm, so it has no axes")
        return self._driver

    @property
    def caveats(self) -> tuple[str, ...]:
        """Return warnings about a leader arm, such as a missing calibration. A simulated arm has no warnings."""
        return () if self._driver is None or self._twin is not None else self._driver.caveats

    @property
    def twin_process(self) -> TwinProcess | None:
        """Return the process of the simulated leader arm; None for any other leader."""
        return self._twin

    def __repr__(self) -> str:
        return f"<Teleoperator {self.name} ({'twin' if self._twin else self._port})>"

    async def source(self) -> dict[str, Any]:
        """Return the description of the leader as plain data, for the process of the teleoperation.

        If the leader is a simulated arm, start it. Raise ``TwinProcessDown`` if it does not start.
        """
        if self._driver is None or self._driver_class is None:
            if ":" in self.name:
                if self.name.startswith(lerobot.PREFIX):
                    options = {"type": self.name.removeprefix(lerobot.PREFIX), **self._options}
                    return {"type": "object", "factory": lerobot.FACTORY, "options": options}
                return {"type": "object", "factory": self.name, "options": self._options}
            if self.name in PAGES:
                self._address_file = Path(f"{run_dir()}/teleop-{os.getpid()}-{next(_numbers)}.url")
                host, number = self._listen
                return {"type": "page", "host": host, "port": number, "address_file": str(self._address_file)}
            return {"type": "operator"}
        if self._twin is not None:
            await self._twin.start()
        port = self._port or (self._twin.port if self._twin is not None else "")
        description: dict[str, Any] = {
            "type": "arm",
            "description": describe_driver(self._driver_class, self.name, port, self._options),
        }
        grippers = [axis for axis in self._driver.table if axis.unit == "percent"]
        if grippers:
            description["gripper"] = [grippers[0].key, grippers[0].low, grippers[0].high]
        return description

    def move_by_hand(self, positions: Mapping[str, float]) -> None:
        """Move joints of a simulated leader arm, as a person's hand would.

        Args:
            positions: Position by joint, in the leader's units.

        Raises:
            RuntimeError: The simulated arm does not run.
            TypeError: The leader is not a simulated arm, or ``positions`` is wrong.
        """
        twin, driver = self._twin, self.driver
        if twin is None:
            raise TypeError(f"{self.name} is not simulated. Move the arm by hand")
        units = dict(zip(driver.axes, driver.model_units(), strict=True))
        offered: object = positions  # a caller's code may not be type-checked
        if not isinstance(offered, Mapping):
            axis = next(iter(units))
            raise TypeError(f"move_by_hand: positions is {shown(offered)}. Give joints: {{{axis!r}: 10.0}}")
        if unknown := [str(key) for key in positions if key not in units]:
            raise TypeError(f"{self.name} has no {', '.join(unknown)}. It has {', '.join(units)}")
        angles = {}
        for key, value in positions.items():
            number, (zero, scale) = finite(as_python(value)), units[key]
            if number is None:
                raise TypeError(f"move_by_hand: {key} is {shown(value)}. Give a finite number, in {driver.unit}")
            angles[key] = (number - zero) / scale

        async def move() -> dict[str, float]:
            await twin.start()
            moved: dict[str, float] = await load(HAND)(twin.control, {**self._hand, **angles})
            return moved

        try:
            self._hand = portal().call(move)
        except TwinProcessDown as down:
            raise RuntimeError(f"move_by_hand: {down}") from None

    @property
    def address(self) -> str:
        """Return the address of the operator's page; empty while it is not served.

        It contains the token that opens the page, so give it to the operator only.
        """
        try:
            return "" if self._address_file is None else self._address_file.read_text()
        except FileNotFoundError:
            return ""

    def cleanup(self) -> None:
        """End the process of a simulated leader arm, if there is one."""
        if self._address_file is not None:
            self._address_file.unlink(missing_ok=True)
        if self._twin is not None:
            portal().call(self._twin.close)

    def __enter__(self) -> Teleoperator:
        return self

    def __exit__(
        self, error_type: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.cleanup()


def parse_listen_address(listen: object) -> tuple[str, int]:
    """Return the host and port at which the operator's page is served.

    Args:
        listen: ``host`` or ``host:port``; empty for 127.0.0.1 and a free port.

    Raises:
        ValueError: ``listen`` is not such a text, or means all addresses of this computer.
    """
    host, _, number = str(listen).partition(":")
    if not isinstance(listen, str) or (number and not (number.isdigit() and int(number) < 65536)):
        raise ValueError(f"a page cannot listen on {listen!r}. Give an address of this host, or address:port")
    # The page refuses host names other than its own. If it listened on all addresses, it would not know the name
    # that the browser uses.
    if _is_every_address(host):
        raise ValueError(
            f"a page cannot listen on {listen!r}, which means all addresses of this computer. Give the address "
            f"that the browser opens, such as 192.0.2.5{f':{number}' if number else ''}"
        )
    return host or "127.0.0.1", int(number or 0)


def _is_every_address(host: str) -> bool:
    try:
        return not any(socket.inet_aton(host))  # ``0`` means the same address as ``0.0.0.0``
    except OSError:
        return False


def _unknown(name: object) -> str:
    names = [*list_leaders(), *OPERATED]
    close = difflib.get_close_matches(str(name), names, n=2)
    hint = f" Did you mean: {', '.join(close)}?" if close else ""
    return f"Teleoperator: {name!r} is not known.{hint} leaders are {', '.join(names)}, and 'module:Class'"


def place_of_map(map_fn: Callable[..., Any] | None) -> str:
    """Return ``module:name`` of a function, from which the process of a teleoperation can import it.

    Raises:
        ValueError: Another process cannot import this function.
    """
    if map_fn is None:
        return ""
    if not inspect.isfunction(map_fn):
        raise ValueError(f"map_fn is {map_fn!r}. Give a function from the leader's positions to the robot's")
    place = f"{map_fn.__module__}:{map_fn.__qualname__}"
    if place.startswith("__main__:") or "<" in place:
        raise ValueError(
            f"map_fn is {place}, which another process cannot import. A teleoperation runs in a separate process, "
            "so move the function to a module"
        )
    return place

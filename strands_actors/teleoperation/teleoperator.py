"""``Teleoperator(...)`` describes a leader for a robot.

Nothing here touches hardware. The process of the teleoperation does.
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

        ``so101_leader``         a leader arm, at ``port`` or as its twin
        ``keyboard``             keys, which ``arm.operate()`` reports
        ``page``, ``gamepad``, ``phone``  a page for touch or a gamepad, served at ``address``
        ``module:Class``         any object with ``get_action()``, with ``options`` as keyword arguments
        ``lerobot:TYPE``         LeRobot's teleoperator of this type, with the fields of its config

    Args:
        name: Name of the leader (see above).
        port: Serial device of a leader arm.
        transport: ``"twin"`` for the twin of a leader arm, in place of a port.
        id: Name under which LeRobot keeps the arm's calibration.
        relative: True: the robot follows the changes of the leader from the poses at engaging. False: the
            robot goes to the leader's pose.
        options: Options of the leader. A page has ``listen``, its address.

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
        id: str | None = None,  # the word of LeRobot
        relative: bool = False,
        **options: Any,
    ) -> None:
        if not isinstance(relative, bool):  # The text "no" would count as true.
            raise TypeError(f"Teleoperator: relative is {shown(relative)}. give True or False")
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
            given = {
                "port": None if ":" in name else port,
                "transport": transport,
                "id": None if ":" in name else id,
            }
            if wrong := [key for key, value in given.items() if value is not None]:
                raise TypeError(f"Teleoperator: {name} has no {', '.join(wrong)}. leave that out")
            if name.startswith(lerobot.PREFIX) and not lerobot.is_there():
                raise ValueError(
                    f"{name} needs lerobot, in this environment. pip install 'strands-actors[lerobot]'"
                )
            if ":" in name:
                own = {"port": port, "id": id}
                self._options = {**{key: value for key, value in own.items() if value is not None}, **options}
            else:
                self.kind = Kind.JOG
                if name in PAGES:
                    self._listen = where_to_listen(options.pop("listen", ""))
                if options or relative:
                    raise TypeError(
                        f"Teleoperator: {name} takes no {', '.join(options) or 'relative'}. leave that out"
                    )
        else:
            raise ValueError(_unknown(name))

    def _lead(self, leader: str, transport: str | None, robot_id: str | None) -> None:
        self.name = leader
        driver_class = list_leaders()[leader]
        if transport not in (None, "twin"):
            raise ValueError(f"Teleoperator: {leader} has no transport {transport!r}. it offers twin")
        for what, given, example in (("port", self._port, "'/dev/ttyACM1'"), ("id", robot_id, "'left'")):
            if given is not None and not (isinstance(given, str) and given.strip()):
                raise TypeError(f"Teleoperator: {what} is {shown(given)}. give it as text: {example}")
        if (self._port is None) == (transport is None):
            raise ValueError(
                f"Teleoperator: give {leader} one of port= and transport='twin': "
                f"Teleoperator({leader!r}, port='/dev/ttyACM1')"
            )
        if unknown := [key for key in self._options if key not in driver_class.OPTIONS]:
            accepted = ", ".join(driver_class.OPTIONS)
            raise ValueError(f"Teleoperator: {leader} takes no {', '.join(unknown)}. it takes {accepted}")
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
        """Return the driver of a leader arm, with axes and units. Raise ``TypeError`` for any other leader."""
        if self._driver is None:
            raise TypeError(f"{self.name} is no arm: it has no axes of its own")
        return self._driver

    @property
    def caveats(self) -> tuple[str, ...]:
        """Return warnings of a leader arm, such as a missing calibration. A twin has no warnings."""
        return () if self._driver is None or self._twin is not None else self._driver.caveats

    @property
    def twin_process(self) -> TwinProcess | None:
        """Return the process of its twin; None if it has no twin."""
        return self._twin

    def __repr__(self) -> str:
        return f"<Teleoperator {self.name} ({'twin' if self._twin else self._port})>"

    async def source(self) -> dict[str, Any]:
        """Return the description of the leader for the process of the teleoperation, as plain data. Start its
        twin, if it has one. Raise ``TwinProcessDown``."""
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
        """Move joints of a leader's twin, as a hand would.

        Args:
            positions: Position by joint, in the leader's units.

        Raises:
            RuntimeError: The twin does not run.
            TypeError: The leader is not a twin, or ``positions`` is wrong.
        """
        twin, driver = self._twin, self.driver
        if twin is None:
            raise TypeError(f"{self.name} is no twin. move it by your own hand")
        units = dict(zip(driver.axes, driver.model_units(), strict=True))
        given: object = positions  # The program may not be type-checked.
        if not isinstance(given, Mapping):
            axis = next(iter(units))
            raise TypeError(f"move_by_hand: it is {shown(given)}. give positions by joint: {{{axis!r}: 10.0}}")
        if unknown := [str(key) for key in positions if key not in units]:
            raise TypeError(f"{self.name} has no {', '.join(unknown)}. it has {', '.join(units)}")
        angles = {}
        for key, value in positions.items():
            number, (zero, scale) = finite(as_python(value)), units[key]
            if number is None:
                raise TypeError(f"move_by_hand: {key} is {shown(value)}. give a finite number, in {driver.unit}")
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
        """Return the address of the page; empty if it is not served (yet). It contains the token that opens the
        page, so give it to the operator only."""
        try:
            return "" if self._address_file is None else self._address_file.read_text()
        except FileNotFoundError:
            return ""

    def cleanup(self) -> None:
        """End its twin, if it has one."""
        if self._address_file is not None:
            self._address_file.unlink(missing_ok=True)
        if self._twin is not None:
            portal().call(self._twin.close)

    def __enter__(self) -> Teleoperator:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.cleanup()


def where_to_listen(listen: object) -> tuple[str, int]:
    """Return host and port of a page.

    Args:
        listen: ``host`` or ``host:port``; empty for 127.0.0.1 and a free port.

    Raises:
        ValueError: It is not such a text, or means every address of this host.
    """
    host, _, number = str(listen).partition(":")
    if not isinstance(listen, str) or (number and not (number.isdigit() and int(number) < 65536)):
        raise ValueError(f"a page cannot listen on {listen!r}. give an address of this host, or address:port")
    # The page refuses host names other than its own. With every address it could not know the name that
    # the browser uses.
    if _is_every_address(host):
        raise ValueError(
            f"a page cannot listen on {listen!r}, which is every address of this host. give the one that its "
            f"browser opens, as 192.0.2.5{f':{number}' if number else ''}"
        )
    return host or "127.0.0.1", int(number or 0)


def _is_every_address(host: str) -> bool:
    try:
        return not any(socket.inet_aton(host))  # ``0`` is another form of ``0.0.0.0``.
    except OSError:
        return False


def _unknown(name: object) -> str:
    known = [*list_leaders(), *OPERATED]
    close = difflib.get_close_matches(str(name), known, n=2)
    hint = f" Did you mean: {', '.join(close)}?" if close else ""
    return f"Teleoperator: {name!r} is not known.{hint} there are {', '.join(known)}, and 'module:Class'"


def place_of_map(map_fn: Callable[..., Any] | None) -> str:
    """Return ``module:name`` of a function, for the process of a teleoperation. Raise ``ValueError`` if that
    process cannot import it."""
    if map_fn is None:
        return ""
    if not inspect.isfunction(map_fn):
        raise ValueError(f"map_fn is {map_fn!r}. give a function from the leader's positions to the robot's")
    place = f"{map_fn.__module__}:{map_fn.__qualname__}"
    if place.startswith("__main__:") or "<" in place:
        raise ValueError(
            f"map_fn is {place}, which no other process can import, and a teleoperation is a process of its own. "
            "move it to a module"
        )
    return place

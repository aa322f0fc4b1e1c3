"""Find the driver of a robot by its name, and register drivers of other packages.

Built-in wires are listed by name and imported when they are needed. A third-party package names its driver
class in the entry point group ``strands_actors.drivers``. A driver that cannot be used causes a warning and a
record (``broken_drivers``), and is never fatal. A registration at run time lasts as long as the process. No
file of the user is written.
"""

from __future__ import annotations

import importlib
import inspect
import os
import re
import warnings
from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.contract.short_names import SHORT_NAMES
from strands_actors.contract.surface import (
    DRIVER_SURFACE,
    HardwareDriver,
    drifted_driver_parameters,
    driver_name,
    missing_driver_members,
)

__all__ = [
    "DEFAULT_DRIVER",
    "DRIVER_CHOICES",
    "DRIVER_SURFACE",
    "LIST_ROBOTS_MODES",
    "MODEL",
    "NATIVE_DRIVER",
    "PLAIN",
    "SIMULATION",
    "HardwareDriver",
    "broken_drivers",
    "canonical_name",
    "constructor_keywords",
    "drifted_driver_parameters",
    "driver_name",
    "get_lerobot_class",
    "get_native_driver_class",
    "leader_name",
    "lerobot_missing",
    "list_driver_coverage",
    "list_leaders",
    "list_native_drivers",
    "list_robots",
    "missing_driver_members",
    "model_of",
    "port_kind",
    "register_native_driver",
    "register_robot",
    "resolve_driver",
]

LIST_ROBOTS_MODES = ("all", "sim", "real", "both")

WIRES = {
    "feetech": "strands_actors.drivers.feetech.driver:Feetech",
    "dynamixel": "strands_actors.drivers.dynamixel.driver:Dynamixel",
    "ur": "strands_actors.drivers.ur.driver:UR",
    "franka": "strands_actors.drivers.franka.driver:Franka",
    "robotiq": "strands_actors.drivers.robotiq.driver:Robotiq",
    "xarm": "strands_actors.drivers.xarm.driver:XArm",
    "kuka": "strands_actors.drivers.kuka.driver:Kuka",
    "kinova": "strands_actors.drivers.kinova.driver:Kinova",
    "rby1": "strands_actors.drivers.rby1.driver:RBY1",
    "earthrover": "strands_actors.drivers.earthrover.driver:EarthRover",
    "yahboom": "strands_actors.drivers.yahboom.driver:YahboomM3Pro",
    "spot": "strands_actors.drivers.spot.driver:Spot",
    "reachy": "strands_actors.drivers.reachy.driver:Reachy",
    "crazyflie": "strands_actors.drivers.crazyflie.driver:Crazyflie",
    "microduck": "strands_actors.drivers.microduck.driver:Microduck",
    "stretch": "strands_actors.drivers.stretch.driver:Stretch",
    "booster": "strands_actors.drivers.booster.driver:BoosterDriver",
    "unitree_g1": "strands_actors.drivers.unitree.driver:G1Driver",
    "unitree": "strands_actors.drivers.unitree.driver:Go2Driver",
}
"""Wire to its driver class. Most wires have one class; each class declares robots."""

LEADERS = {
    "feetech": "strands_actors.drivers.feetech.leader:FeetechLeader",
    "dynamixel": "strands_actors.drivers.dynamixel.leader:DynamixelLeader",
}
"""Wire to its class of leader arms. These are no robots, since nothing drives them."""

SIMULATION = "strands_actors.drivers.sim.driver:SimDriver"
"""Drives any of these robots in simulation."""

MODEL = "strands_actors.drivers.model.driver:ModelDriver"
"""Simulates a user's model."""

PLAIN = "strands_actors.drivers.plain.driver:PlainDriver"
"""Runs a driver class of the drivers page, which is not a ``Driver``, as a tree."""

LEROBOT = "strands_actors.drivers.plain.lerobot.types:TYPES"
"""Robots that LeRobot has a type for, by the names of this package."""

LEROBOT_CLASS = "strands_actors.drivers.plain.lerobot.follower:class_of"
LEROBOT_MISSING = "strands_actors.drivers.plain.lerobot.types:missing"

OTHER_ROBOTS = (
    "ability_hand", "adam_lite", "aero_hand", "aliengo", "allegro_hand", "aloha", "anymal_b", "anymal_c", "apollo",
    "arx_l5", "asimov_v0", "cassie", "dynamixel_2r", "elf2", "fourier_n1", "go1", "google_robot", "jvrc",
    "leap_hand", "mujoco_humanoid", "op3", "piper", "robot_soccer_kit", "sawyer", "shadow_dexee", "shadow_hand",
    "skydio_x2", "talos", "tiago_dual", "toddlerbot_2xc", "toddlerbot_2xm", "trossen_wxai", "unitree_a1", "vx300s",
    "wx250s", "yam", "z1",
)  # fmt: skip
"""Robots that strands-robots knows by name, without a hardware driver anywhere. After
``register_robot(name, model_xml=...)`` such a robot can be simulated."""

NATIVE_DRIVER = "strands"
"""``Robot(driver=)`` for a driver class of this package, or a registered one."""

DEFAULT_DRIVER = "lerobot"
"""The driver of a robot without a native driver."""

DRIVER_CHOICES = ("auto", DEFAULT_DRIVER, NATIVE_DRIVER)
"""Values of ``Robot(driver=)``."""

OWN_KEYWORDS = ("cameras", "data_config", "mesh", "port", "require_drill", "sim", "tool_name", "transport")
"""Keywords of every driver that runs as a tree."""


class Registered(NamedTuple):
    """A robot that was registered at run time."""

    driver: str | None  # strands or lerobot; None: the available one
    model_xml: str | None


_broken: dict[str, str] = {}
_registered: dict[str, type[Any]] = {}
_found: set[str] = set()  # robots of the drivers that were loaded at the start
_robots: dict[str, Registered] = {}
_aliases: dict[str, str] = {}
_loaded = False


def _load() -> None:
    global _loaded
    if _loaded:
        return
    _loaded = True
    from importlib.metadata import entry_points  # takes 9 ms; a robot's processes get the name of their driver

    locations = dict(WIRES)
    for point in entry_points(group="strands_actors.drivers"):
        locations.setdefault(point.name, point.value)
    for wire, location in locations.items():
        module, _, name = location.partition(":")
        try:
            driver_class = getattr(importlib.import_module(module), name)
            missing = missing_driver_members(driver_class)
            if missing:
                raise TypeError(f"{name} lacks {', '.join(missing)}")
            robots, aliases = list(driver_class.SUPPORTED_ROBOTS), dict(getattr(driver_class, "ALIASES", {}))
        except Exception as error:  # a third-party module may raise anything
            _broken[wire] = f"{type(error).__name__}: {error}"
            continue
        for robot in robots:
            _registered.setdefault(robot, driver_class)
        _aliases.update(aliases)
    for robot, kind in load(LEROBOT).items():
        if kind.type != robot:
            _aliases.setdefault(kind.type, robot)
    _found.update(_registered)
    for wire, why in sorted(_broken.items()):
        warnings.warn(f"driver {wire} cannot be used: {why}", stacklevel=3)


def broken_drivers() -> dict[str, str]:
    """Return wires and entry points that cannot be used, with the reasons."""
    _load()
    return dict(_broken)


def constructor_keywords(cls: type[Any]) -> list[str]:
    """Return the keywords that ``Robot`` passes on to a driver class, sorted. ``**`` means any keyword."""
    if issubclass(cls, Driver):
        return sorted({*OWN_KEYWORDS, *cls.OPTIONS, *cls.SPELLINGS})
    parameters = inspect.signature(cls).parameters.values()
    names = [one.name for one in parameters if one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL)]
    return sorted(names + ["**" for one in parameters if one.kind is one.VAR_KEYWORD])


def register_native_driver(name: str, cls: type[Any], overwrite: bool = False) -> None:
    """Use ``cls`` as the driver of a robot.

    Args:
        name: The robot, or one of its aliases.
        cls: The driver class.
        overwrite: Replace a present driver.

    Raises:
        TypeError: The class lacks members. The text names them.
        ValueError: The robot is unknown, or has a driver already.
    """
    _load()
    missing = missing_driver_members(cls)
    if missing:
        raise TypeError(f"register_native_driver: {cls.__name__} lacks {', '.join(missing)}")
    robot = canonical_name(name)
    if robot not in list_driver_coverage() and robot not in getattr(cls, "SUPPORTED_ROBOTS", ()):
        raise ValueError(
            f"register_native_driver: nobody knows a robot called {name!r}. call register_robot({name!r}) first"
        )
    if robot in _registered and not overwrite:
        raise ValueError(
            f"register_native_driver: {_both(name, robot)} is already served by {driver_name(_registered[robot])}. "
            "pass overwrite=True to replace it"
        )
    _registered[robot] = cls


def _both(name: str, robot: str) -> str:
    return robot if name == robot else f"{name} ({robot})"


def register_robot(
    name: str,
    *,
    model_xml: str | os.PathLike[str] | None = None,
    hardware: Mapping[str, str] | None = None,
    aliases: Iterable[str] = (),
    overwrite: bool = False,
) -> None:
    """Make a robot known by name, in this process.

    Args:
        name: Its name.
        model_xml: An MJCF or URDF file, which ``Robot(name)`` simulates.
        hardware: ``{"driver": ...}`` with ``strands`` or ``lerobot``. Its class is given to
            ``register_native_driver``.
        aliases: Its other names.
        overwrite: Replace a known robot.

    Raises:
        ValueError: A name is known in any spelling or invalid, or ``hardware`` has another key or driver.
        FileNotFoundError: The model file does not exist.
    """
    _load()
    given = dict(hardware or {})
    driver = given.pop("driver", None)
    if given:
        raise ValueError(f"register_robot: hardware has no {', '.join(sorted(given))}. it takes driver")
    if driver not in (None, "strands", "lerobot"):
        raise ValueError(f"register_robot: hardware driver is {driver!r}. use 'strands' or 'lerobot'")
    names = [_checked(one, "register_robot") for one in (name, *aliases)]
    for one in names:
        if not _NAME.match(one):
            raise ValueError(f"register_robot: the name is {one!r}. use 1 to 64 of A-Z a-z 0-9 _ -")
    taken = {_plain(one) for one in (*_known(), *_found, *SHORT_NAMES, *_aliases)}
    present = [one for one in names if _plain(one) in taken]
    if present and not overwrite:
        raise ValueError(
            f"register_robot: {', '.join(present)} is known already. pass overwrite=True to replace it"
        )
    if model_xml is not None and not os.path.isfile(os.path.expanduser(model_xml)):
        raise FileNotFoundError(
            f"register_robot: there is no file {os.fspath(model_xml)!r}. give an MJCF or a URDF"
        )
    robot = canonical_name(name)
    _robots[robot] = Registered(
        driver, None if model_xml is None else os.path.abspath(os.path.expanduser(model_xml))
    )
    _aliases.update(dict.fromkeys(names[1:], robot))


def canonical_name(name: str) -> str:
    """Return the robot's name for an alias or another spelling: ``SO-101`` is ``so101``. An unknown name is
    returned unchanged.

    Raises:
        TypeError: The name is not a text.
        ValueError: The name is empty.
    """
    _load()
    _checked(name, "Robot")
    names = {**{robot: robot for robot in _known()}, **SHORT_NAMES, **_aliases}
    if name not in names:
        plain = _plain(name)
        name = next((each for each in names if _plain(each) == plain), name)
    return names.get(name, name)


_NAME = re.compile(r"(?=.*[A-Za-z0-9])[A-Za-z0-9_-]{1,64}\Z")
"""Valid names of robots. A robot's name is a key of the mesh, and an agent's tool."""


def _checked(name: object, caller: str) -> str:
    if not isinstance(name, str) or not name:
        wrong = ValueError if isinstance(name, str) else TypeError
        raise wrong(f"{caller}: the name is {name!r}. give the name of a robot as text: list_robots() has them all")
    return name


def _plain(name: str) -> str:
    """Return a name without the differences between spellings: case and separators."""
    return "".join(letter for letter in name.lower() if letter.isalnum())


def _known() -> set[str]:
    return {*_registered, *_robots, *load(LEROBOT), *OTHER_ROBOTS}


def list_robots(mode: str = "all") -> list[str]:
    """Return the names of known robots, sorted.

    Args:
        mode: ``all``; ``sim``, which ``Robot(name)`` can simulate; ``real``, which have a driver; or ``both``.

    Raises:
        ValueError: It is another word.
    """
    _load()
    if mode not in LIST_ROBOTS_MODES:
        raise ValueError(f"list_robots: mode is {mode!r}. use {', '.join(map(repr, LIST_ROBOTS_MODES))}")
    robots = _known()
    if mode in ("sim", "both"):
        robots = {name for name in robots if _simulates(name)}
    if mode in ("real", "both"):
        robots &= {*_registered, *_lerobots()}
    return sorted(robots)


def _simulates(robot: str) -> bool:
    driver_class = _registered.get(robot)
    has_twin = isinstance(driver_class, type) and issubclass(driver_class, Driver)
    return has_twin or model_of(robot) is not None


def _lerobots() -> set[str]:
    """Return the robots that LeRobot has a class for, or that were registered for LeRobot."""
    return {*load(LEROBOT), *(name for name, robot in _robots.items() if robot.driver == "lerobot")}


def get_native_driver_class(name: str) -> type[Any] | None:
    """Return the driver class of a robot or alias; None if it has no native driver."""
    _load()
    return _registered.get(canonical_name(name))


def port_kind(name: str) -> Literal["serial", "address"] | None:
    """Return the kind of a robot's ``port``: a serial device, or an address on a network. None for a robot
    without a driver.

    A driver that does not declare it has an address. Robots that only LeRobot drives are servo buses, unless
    ``types.toml`` declares an address.
    """
    driver_class = get_native_driver_class(name)
    if driver_class is not None:
        return "serial" if getattr(driver_class, "PORT_KIND", None) == "serial" else "address"
    robot = canonical_name(name)
    if "lerobot" not in list_driver_coverage().get(robot, ()):
        return None
    kind = load(LEROBOT).get(robot)
    return "serial" if kind is None or kind.serial else "address"


def resolve_driver(name: str, driver: str = "auto") -> Literal["strands", "lerobot"]:
    """Return the driver of a robot: the requested one, else the registered one, else a native driver, else
    LeRobot.

    Raises:
        ValueError: The word is unknown, or the robot has no native driver and one was requested.
    """
    robot = canonical_name(name)
    if driver not in DRIVER_CHOICES:
        raise ValueError(f"Robot: driver is {driver!r}. use one of {', '.join(map(repr, DRIVER_CHOICES))}")
    record = _robots.get(robot)
    if driver == "auto":
        driver = (record.driver if record else None) or (NATIVE_DRIVER if robot in _registered else DEFAULT_DRIVER)
    if driver == DEFAULT_DRIVER:
        return "lerobot"
    if robot not in _registered:
        theirs = "driver='lerobot' runs LeRobot's own class of it. " if robot in load(LEROBOT) else ""
        native = ", ".join(sorted(list_native_drivers()))
        raise ValueError(f"Robot: {name} has no native driver. {theirs}these have one: {native}")
    return "strands"


def get_lerobot_class(name: str) -> type[Any]:
    """Return the class that runs LeRobot's own class of a robot.

    Raises:
        ValueError: LeRobot has no such class, or is not installed. The text has the command that installs it.
    """
    robot, types = canonical_name(name), load(LEROBOT)
    if robot not in types:
        raise ValueError(f"Robot: LeRobot has no class for {name}. it has one for {', '.join(sorted(types))}")
    if line := lerobot_missing(robot):
        raise ValueError(f"Robot: {name} is driven by LeRobot's own class, and that is not installed. {line}")
    lerobot_class: type[Any] = load(LEROBOT_CLASS)(robot)
    return lerobot_class


def lerobot_missing(robot: str) -> str:
    """Return the command that installs the missing packages of a robot's LeRobot class; empty if no package is
    missing, or there is no class."""
    kind = load(LEROBOT).get(robot)
    return "" if kind is None else str(load(LEROBOT_MISSING)(kind))


def model_of(name: str) -> str | None:
    """Return the model file that a robot was registered with."""
    record = _robots.get(canonical_name(name))
    return None if record is None else record.model_xml


def list_native_drivers() -> dict[str, str]:
    """Return the driver class's name of each robot with a native driver, sorted."""
    _load()
    return {name: driver_name(_registered[name]) for name in sorted(_registered)}


def list_driver_coverage() -> dict[str, tuple[str, ...]]:
    """Return every known robot with its drivers: ``lerobot``, ``strands``, both, or an empty tuple."""
    _load()
    lerobots = _lerobots()
    return {
        name: tuple(driver for driver, has in (("lerobot", lerobots), ("strands", _registered)) if name in has)
        for name in list_robots()
    }


def list_leaders() -> dict[str, type[Driver]]:
    """Return the leader arms by name, for ``Teleoperator``."""
    classes = [load(where) for where in LEADERS.values()]
    return {name: driver_class for driver_class in classes for name in sorted(driver_class.SUPPORTED_ROBOTS)}


def leader_name(name: str) -> str | None:
    """Return the leader arm's name for an alias or another spelling; None for an unknown name."""
    leaders = list_leaders()
    names = {robot: robot for robot in leaders}
    for driver_class in leaders.values():
        names |= driver_class.ALIASES
    plain = _plain(name)
    return next((robot for each, robot in names.items() if _plain(each) == plain), None)

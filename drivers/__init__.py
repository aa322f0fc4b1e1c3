"""Find the driver of a robot by its name, and register drivers of other packages.

The classes of the built-in drivers are listed as text and imported when they are needed. A third-party package
names its driver class in the entry point group ``strands_actors.drivers``. If a driver cannot be imported, the
user gets a warning and ``broken_drivers`` returns the reason. All other drivers still work. A registration at run
time lasts until this process ends, and writes no file.
"""

from __future__ import annotations

import importlib
import inspect
import os
import re
import threading
import warnings
from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple

from strands_actors.contract.contract_version import unsupported_contract
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
    "ROS2",
    "ROS2_DRIVER",
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
    "register_own_table",
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
    "can_motors": "strands_actors.drivers.can_motors.driver:CanMotors",
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
"""Name of a wire protocol to the location of its driver class. Each class supports one or several robots."""

PARTS = "strands_actors.parts.driver:PartsDriver"
"""Location of the class that drives a robot that is made of other robots (``parts=``). Such a robot may have any
name."""

OWN_TABLES = {"table": "can_motors"}
"""Keyword with the table of a user's own robot, to the wire that reads it. Such a robot may have any name."""

LEADERS = {
    "feetech": "strands_actors.drivers.feetech.leader:FeetechLeader",
    "dynamixel": "strands_actors.drivers.dynamixel.leader:DynamixelLeader",
}
"""Name of a wire protocol to the class of its leader arms. A person moves them by hand, so they are no robots."""

SIMULATION = "strands_actors.drivers.sim.driver:SimDriver"
"""Location of the class that drives any of these robots in simulation."""

URDF = "strands_actors.drivers.common.kinematics.urdf:urdf_of"
"""Location of the function that writes the URDF of a robot, from ``Driver.link_rows``."""

TOOL_POSE = "strands_actors.drivers.common.kinematics.tool:tool_pose"
"""Location of the function that computes the pose of an arm's tool, from ``Driver.arm_model``."""

MODEL = "strands_actors.drivers.model.driver:ModelDriver"
"""Location of the class that simulates a user's model file."""

ROS2 = "strands_actors.drivers.ros2.driver:Ros2Driver"
"""Location of the class that drives a node of a ROS 2 graph, by a table of the user."""

PLAIN = "strands_actors.drivers.plain.driver:PlainDriver"
"""Location of the class that runs a user's plain driver class (``docs/drivers.md``), which is no ``Driver``."""

LEROBOT = "strands_actors.drivers.plain.lerobot.types:TYPES"
"""Location of the table of robots that LeRobot supports, by the names of this package."""

LEROBOT_CLASS = "strands_actors.drivers.plain.lerobot.follower:class_of"
LEROBOT_MISSING = "strands_actors.drivers.plain.lerobot.types:missing"

OTHER_ROBOTS = (
    "ability_hand", "adam_lite", "aero_hand", "aliengo", "allegro_hand", "aloha", "anymal_b", "anymal_c", "apollo",
    "arx_l5", "asimov_v0", "cassie", "dynamixel_2r", "elf2", "fourier_n1", "go1", "google_robot", "jvrc",
    "leap_hand", "mujoco_humanoid", "op3", "piper", "robot_soccer_kit", "sawyer", "shadow_dexee", "shadow_hand",
    "skydio_x2", "talos", "tiago_dual", "toddlerbot_2xc", "toddlerbot_2xm", "trossen_wxai", "unitree_a1", "vx300s",
    "wx250s", "z1",
)  # fmt: skip
"""Robots that strands-robots knows by name, without a hardware driver anywhere. After
``register_robot(name, model_xml=...)`` such a robot can be simulated."""

NATIVE_DRIVER = "strands"
"""Value of ``Robot(driver=)`` for a driver class of this package, or for a registered class."""

DEFAULT_DRIVER = "lerobot"
"""Value of ``Robot(driver=)`` for LeRobot's class. It is the default of a robot without a native driver."""

ROS2_DRIVER = "ros2"
"""Value of ``Robot(driver=)`` for a node of a ROS 2 graph. The robot needs no registration, but a ``table``."""

DRIVER_CHOICES = ("auto", DEFAULT_DRIVER, NATIVE_DRIVER, ROS2_DRIVER)
"""Values of ``Robot(driver=)``."""

OWN_KEYWORDS = ("cameras", "data_config", "id", "mesh", "port", "require_drill", "sim", "tool_name", "transport")
"""Keywords that ``Robot`` accepts for every driver that is a subclass of ``Driver``."""


class Registered(NamedTuple):
    """A robot that was registered at run time."""

    driver: str | None  # "strands" or "lerobot"; None: use the driver that the robot has
    model_xml: str | None


_broken: dict[str, str] = {}
_registered: dict[str, type[Any]] = {}
_with_driver_class: set[str] = (
    set()
)  # names of the robots for which a driver class was found when the drivers were loaded
_robots: dict[str, Registered] = {}
_aliases: dict[str, str] = {}
_loaded = False
_loading = threading.RLock()
_is_loading = False


def _load() -> None:
    global _loaded, _is_loading
    if _loaded:
        return
    # Another thread waits until all drivers are there. The thread that loads them may come here again.
    with _loading:
        if _loaded or _is_loading:
            return
        _is_loading = True
        try:
            _load_all()
        finally:
            _is_loading, _loaded = False, True


def _load_all() -> None:
    # This import takes 9 ms, so it is not at the top of the module. The processes of a robot never need it, since
    # they get the location of their driver class.
    from importlib.metadata import entry_points

    locations = dict(WIRES)
    for point in entry_points(group="strands_actors.drivers"):
        locations.setdefault(point.name, point.value)
    for wire, location in locations.items():
        module, _, name = location.partition(":")
        try:
            driver_class = getattr(importlib.import_module(module), name)
            if wire not in WIRES and (why_not := unsupported_contract(driver_class)):
                raise ValueError(why_not)
            missing = missing_driver_members(driver_class)
            if missing:
                raise TypeError(f"{name} lacks {', '.join(missing)}")
            robots, aliases = list(driver_class.SUPPORTED_ROBOTS), dict(getattr(driver_class, "ALIASES", {}))
        except Exception as error:  # a module of another package may raise anything
            _broken[wire] = f"{type(error).__name__}: {error}"
            continue
        for robot in robots:
            _registered.setdefault(robot, driver_class)
        _aliases.update(aliases)
    for robot, robot_type in load(LEROBOT).items():
        if robot_type.type != robot:
            _aliases.setdefault(robot_type.type, robot)
    _with_driver_class.update(_registered)
    for wire, reason in sorted(_broken.items()):
        warnings.warn(f"driver {wire} cannot be used: {reason}", stacklevel=4)


def broken_drivers() -> dict[str, str]:
    """Return the drivers that cannot be used, each with the reason.

    A key is the folder of a driver in ``drivers/``, or the name of an entry point of another package.
    """
    _load()
    return dict(_broken)


def constructor_keywords(cls: type[Any]) -> list[str]:
    """Return the keyword arguments that ``Robot`` passes on to a driver class, sorted. ``**`` means that the class
    accepts any keyword."""
    if issubclass(cls, Driver):
        return sorted({*OWN_KEYWORDS, *cls.OPTIONS, *cls.SPELLINGS})
    parameters = inspect.signature(cls).parameters.values()
    names = [
        parameter.name
        for parameter in parameters
        if parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
    ]
    return sorted(names + ["**" for parameter in parameters if parameter.kind is parameter.VAR_KEYWORD])


def register_native_driver(name: str, cls: type[Any], overwrite: bool = False) -> None:
    """Use ``cls`` as the driver of a robot.

    Args:
        name: Name of the robot, or one of its aliases.
        cls: The driver class.
        overwrite: True to replace the driver that the robot already has.

    Raises:
        TypeError: The class lacks methods or attributes that a driver needs. The message names them.
        ValueError: The robot is unknown, or it already has a driver and ``overwrite`` is False. Or this package
            does not support the version of the driver contract that the class declares.
    """
    _load()
    if why_not := unsupported_contract(cls):
        raise ValueError(f"register_native_driver: {why_not}")
    missing = missing_driver_members(cls)
    if missing:
        raise TypeError(f"register_native_driver: the class {cls.__name__} lacks {', '.join(missing)}. Add them")
    robot = canonical_name(name)
    if robot not in list_driver_coverage() and robot not in getattr(cls, "SUPPORTED_ROBOTS", ()):
        raise ValueError(f"register_native_driver: there is no robot {name!r}. Call register_robot({name!r}) first")
    if robot in _registered and not overwrite:
        raise ValueError(
            f"register_native_driver: {_both(name, robot)} already has the driver "
            f"{driver_name(_registered[robot])}. Pass overwrite=True to replace it"
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
    """Add a robot to the known robots, in this process only.

    Args:
        name: Name of the robot.
        model_xml: An MJCF or URDF file. ``Robot(name)`` simulates it.
        hardware: ``{"driver": ...}`` with the value ``strands`` or ``lerobot``. Register the driver class of a
            ``strands`` robot with ``register_native_driver``.
        aliases: Other names of the robot.
        overwrite: True to replace a robot that is already known.

    Raises:
        ValueError: A name is invalid, or it is already known, even in another spelling. Or ``hardware`` has an
            unknown key or driver.
        FileNotFoundError: The model file does not exist.
    """
    _load()
    options = dict(hardware or {})
    driver = options.pop("driver", None)
    if options:
        raise ValueError(
            f"register_robot: hardware has the unknown key {', '.join(sorted(options))}. Give only 'driver'"
        )
    if driver not in (None, "strands", "lerobot"):
        raise ValueError(f"register_robot: hardware driver is {driver!r}. Use 'strands' or 'lerobot'")
    names = [_checked(spelling, "register_robot") for spelling in (name, *aliases)]
    for spelling in names:
        if not _NAME.match(spelling):
            raise ValueError(f"register_robot: the name is {spelling!r}. Use 1 to 64 characters of A-Z a-z 0-9 _ -")
    used_names = {_plain(spelling) for spelling in (*_robot_names(), *_with_driver_class, *SHORT_NAMES, *_aliases)}
    present = [spelling for spelling in names if _plain(spelling) in used_names]
    if present and not overwrite:
        raise ValueError(
            f"register_robot: {', '.join(present)} is known already. Pass overwrite=True to replace it"
        )
    if model_xml is not None and not os.path.isfile(os.path.expanduser(model_xml)):
        raise FileNotFoundError(
            f"register_robot: there is no file {os.fspath(model_xml)!r}. Give an MJCF or a URDF"
        )
    robot = canonical_name(name)
    _robots[robot] = Registered(
        driver, None if model_xml is None else os.path.abspath(os.path.expanduser(model_xml))
    )
    _aliases.update(dict.fromkeys(names[1:], robot))


def register_own_table(name: str, keywords: Mapping[str, Any]) -> None:
    """Register a robot of a new name, if a keyword of ``OWN_TABLES`` describes it.

    Args:
        name: Name of the robot. A known name keeps its driver.
        keywords: The keywords of ``Robot``.
    """
    wire = next((wire for keyword, wire in OWN_TABLES.items() if keywords.get(keyword) is not None), None)
    if wire is not None and name not in list_driver_coverage():
        register_robot(name, hardware={"driver": NATIVE_DRIVER})
        register_native_driver(name, load(WIRES[wire]))


def canonical_name(name: str) -> str:
    """Return the robot's name for an alias or another spelling: ``SO-101`` is ``so101``. An unknown name is
    returned unchanged.

    Raises:
        TypeError: The name is not a text.
        ValueError: The name is empty.
    """
    _load()
    _checked(name, "Robot")
    names = {**{robot: robot for robot in _robot_names()}, **SHORT_NAMES, **_aliases}
    if name not in names:
        plain = _plain(name)
        name = next((each for each in names if _plain(each) == plain), name)
    return names.get(name, name)


_NAME = re.compile(r"(?=.*[A-Za-z0-9])[A-Za-z0-9_-]{1,64}\Z")
"""Valid names of robots. A robot's name is a key of the mesh, and an agent's tool."""


def _checked(name: object, caller: str) -> str:
    if not isinstance(name, str) or not name:
        wrong = ValueError if isinstance(name, str) else TypeError
        raise wrong(f"{caller}: the name is {name!r}. Give the name of a robot as text: list_robots() has them all")
    return name


def _plain(name: str) -> str:
    """Return a name in lower case and without separators, to compare spellings: ``SO-101`` gives ``so101``."""
    return "".join(letter for letter in name.lower() if letter.isalnum())


def _robot_names() -> set[str]:
    return {*_registered, *_robots, *load(LEROBOT), *OTHER_ROBOTS}


def list_robots(mode: str = "all") -> list[str]:
    """Return the names of known robots, sorted.

    Args:
        mode: ``all`` for every robot; ``sim`` for robots that ``Robot(name)`` can simulate; ``real`` for robots
            with a hardware driver; ``both`` for robots that can be simulated and have a hardware driver.

    Raises:
        ValueError: ``mode`` is none of these four words.
    """
    _load()
    if mode not in LIST_ROBOTS_MODES:
        raise ValueError(f"list_robots: mode is {mode!r}. Use {', '.join(map(repr, LIST_ROBOTS_MODES))}")
    robots = _robot_names()
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
    """Return the driver class of a robot or alias, from this package or registered. None without such a class."""
    _load()
    return _registered.get(canonical_name(name))


def port_kind(name: str) -> Literal["serial", "address"] | None:
    """Return whether a robot's ``port`` is a serial device or an address on a network. None for a robot without a
    driver.

    A driver class without ``PORT_KIND`` gets ``address``. A robot that only LeRobot can drive gets ``serial``,
    unless ``types.toml`` declares an address.
    """
    driver_class = get_native_driver_class(name)
    if driver_class is not None:
        return "serial" if getattr(driver_class, "PORT_KIND", None) == "serial" else "address"
    robot = canonical_name(name)
    if "lerobot" not in list_driver_coverage().get(robot, ()):
        return None
    robot_type = load(LEROBOT).get(robot)
    return "serial" if robot_type is None or robot_type.serial else "address"


def resolve_driver(name: str, driver: str = "auto") -> Literal["strands", "lerobot", "ros2"]:
    """Return which kind of driver runs a robot: ``strands`` (a class of this package, or registered),
    ``lerobot``, or ``ros2`` (a node of a ROS 2 graph).

    A requested driver is used. With ``auto``, the robot's registration decides. Without a registration, a robot
    with a ``strands`` driver gets that, and every other robot gets ``lerobot``.

    Raises:
        ValueError: ``driver`` is not in ``DRIVER_CHOICES``, or it is ``strands`` and the robot has no such driver.
    """
    robot = canonical_name(name)
    if driver not in DRIVER_CHOICES:
        raise ValueError(f"Robot: driver is {driver!r}. Use one of {', '.join(map(repr, DRIVER_CHOICES))}")
    if driver == ROS2_DRIVER:
        return "ros2"
    record = _robots.get(robot)
    if driver == "auto":
        driver = (record.driver if record else None) or (NATIVE_DRIVER if robot in _registered else DEFAULT_DRIVER)
    if driver == DEFAULT_DRIVER:
        return "lerobot"
    if robot not in _registered:
        theirs = "driver='lerobot' runs LeRobot's own class of this robot. " if robot in load(LEROBOT) else ""
        native = ", ".join(sorted(list_native_drivers()))
        raise ValueError(f"Robot: {name} has no native driver. {theirs}these robots have a native driver: {native}")
    return "strands"


def get_lerobot_class(name: str) -> type[Any]:
    """Return the driver class by which this package runs LeRobot's class of a robot.

    Raises:
        ValueError: LeRobot has no class for this robot, or LeRobot is not installed. The message contains the
            command that installs it.
    """
    robot, types = canonical_name(name), load(LEROBOT)
    if robot not in types:
        raise ValueError(f"Robot: LeRobot has no class for {name}. Give one of {', '.join(sorted(types))}")
    if line := lerobot_missing(robot):
        raise ValueError(f"Robot: {name} is driven by LeRobot's own class, which is not installed. Run: {line}")
    lerobot_class: type[Any] = load(LEROBOT_CLASS)(robot)
    return lerobot_class


def lerobot_missing(robot: str) -> str:
    """Return the command that installs the packages which LeRobot's class of a robot needs. Empty if they are
    installed, or if LeRobot has no class for the robot."""
    robot_type = load(LEROBOT).get(robot)
    return "" if robot_type is None else str(load(LEROBOT_MISSING)(robot_type))


def model_of(name: str) -> str | None:
    """Return the path of the model file with which a robot was registered; None without one."""
    record = _robots.get(canonical_name(name))
    return None if record is None else record.model_xml


def list_native_drivers() -> dict[str, str]:
    """Return the name of the driver class by name of the robot, sorted. The robots are those of this package and
    those for which a driver class was registered."""
    _load()
    return {name: driver_name(_registered[name]) for name in sorted(_registered)}


def list_driver_coverage() -> dict[str, tuple[str, ...]]:
    """Return every known robot with the drivers that it has. The drivers are ``lerobot`` and ``strands``; a robot
    may have one of them, two or no driver."""
    _load()
    lerobots = _lerobots()
    return {
        name: tuple(driver for driver, has in (("lerobot", lerobots), ("strands", _registered)) if name in has)
        for name in list_robots()
    }


def list_leaders() -> dict[str, type[Driver]]:
    """Return the leader arms by name, for ``Teleoperator``."""
    classes = [load(location) for location in LEADERS.values()]
    return {name: driver_class for driver_class in classes for name in sorted(driver_class.SUPPORTED_ROBOTS)}


def leader_name(name: str) -> str | None:
    """Return the name of a leader arm for its alias or another spelling; None if no leader arm has that name."""
    leaders = list_leaders()
    names = {robot: robot for robot in leaders}
    for driver_class in leaders.values():
        names |= driver_class.ALIASES
    plain = _plain(name)
    return next((robot for each, robot in names.items() if _plain(each) == plain), None)

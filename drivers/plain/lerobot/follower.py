"""An object of LeRobot's, in the wire process, as a driver class of the drivers page.

LeRobot energises a robot when it connects. This class keeps the torque off while it connects, if it can
reach the robot's buses. The tree's arming then energises the motors at their present positions. Robots with
other buses are energised by connecting, as in LeRobot.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from inspect import signature
from typing import Any, ClassVar

from .types import TYPES, Type

GOAL, PRESENT, TORQUE = "Goal_Position", "Present_Position", "Torque_Enable"
"""Register names of LeRobot."""
LOOKS, LOOK_S = 4, 0.03
"""How often the torque is read back, and the pause in between in seconds, so that late answers arrive."""
TORQUE_EVERY = 3
"""Readings of the positions for each reading of the torque: about ten a second at 30 a second. A servo that
resets or is overloaded stays limp for longer. Reading the torque each time would cost a third of the
bus."""
LIMP = "limp"
"""Fault text of a motor that has lost its torque."""
TRIES = 2
"""Retries after a bad answer. The deadline of the call limits all of them."""


class Follower:
    """``tool_name``: LeRobot's ``id``, under which the robot was calibrated. Other keywords are fields of
    LeRobot's config, as mappings for nested configs."""

    ROBOT: ClassVar[str]
    DRIVER: ClassVar[str] = "strands_actors.drivers.plain.lerobot.driver:LeRobotDriver"

    def __init__(self, port: str | None = None, tool_name: str | None = None, **fields: Any) -> None:
        fields.pop("data_config", None)
        self._kind = kind = TYPES[self.ROBOT]
        if port is not None and not kind.port:
            raise ValueError(
                f"{kind.type} has no port of its own. give the fields of its config: left_arm_config={{...}}"
            )
        self._fields = {"id": tool_name, **fields, **({kind.port: port} if port is not None else {})}
        self._robot = self._make()
        self._energised = False
        self._readings = 0
        self.limp: frozenset[str] = frozenset()
        """Motors that were energised, and had no torque at the last reading."""

    def _make(self) -> Any:
        import draccus  # LeRobot depends on it, and parses its command line with it

        robots = importlib.import_module("lerobot.robots")
        importlib.import_module(f"lerobot.robots.{self._kind.module}")
        config_class = robots.RobotConfig.get_choice_class(self._kind.type)
        fields = _fields_of(config_class)
        if unknown := [name for name in self._fields if name not in fields]:
            raise ValueError(f"{self._kind.type} has no {', '.join(unknown)}. it has {', '.join(fields)}")
        own = {"cameras": {}, "use_degrees": True, "disable_torque_on_disconnect": True}
        given = {name: value for name, value in own.items() if name in fields} | self._fields
        return robots.make_robot_from_config(draccus.decode(config_class, given))

    @property
    def action_features(self) -> Mapping[str, Any]:
        features: Mapping[str, Any] = self._robot.action_features
        return features

    @property
    def is_connected(self) -> bool:
        """Return True if it may be commanded. A stop ends that."""
        return self._energised and bool(self._robot.is_connected)

    def connect(self) -> None:
        """Connect at the first call, without torque if possible. Energise at the present position at the
        next."""
        robot, kind = self._robot, self._kind
        if robot.is_connected and kind.holds:
            self._energise()
            return
        if robot.is_connected:  # it was stopped, and only a new connection energises it
            robot.disconnect()
        with contextlib.ExitStack() as stack:
            for bus in self._buses():
                stack.enter_context(_without_torque(bus))
            robot.connect(**({"calibrate": False} if "calibrate" in signature(robot.connect).parameters else {}))
        if not robot.is_calibrated:
            robot.disconnect()
            raise ConnectionError(
                f"{kind.type} {self._fields['id']!r} is not calibrated as its motors are. run lerobot-calibrate "
                f"--robot.type={kind.type} --robot.id={self._fields['id']}"
            )
        if not kind.holds:
            self._energised = True
        elif failure := self._each([functools.partial(_limp, bus) for bus in self._buses()]):
            raise ConnectionError(failure)

    def _energise(self) -> None:
        for bus in self._buses():
            motors = self._goals(bus)
            bus.sync_write(GOAL, _read(bus, PRESENT, motors), normalize=False)  # an earlier goal would be a jump
            bus.enable_torque(num_retry=TRIES)
        self._energised, self._readings, self.limp = True, 0, frozenset()

    def get_observation(self) -> Mapping[str, Any]:
        observed: Mapping[str, Any] = self._robot.get_observation()
        if self._energised and self._kind.holds:
            self._readings += 1
            if self._readings % TORQUE_EVERY == 0:
                self.limp = frozenset(name for path in self._kind.buses for name in self._without_torque(path))
        return observed

    def send_action(self, action: Mapping[str, float]) -> None:
        """Send an action.

        Raises:
            RuntimeError: It would move a motor without torque. On an STS3215 a goal turns the torque on.
        """
        if limp := self.limp_of(action):
            raise RuntimeError(f"{', '.join(limp)} has no torque")
        self._robot.send_action(dict(action))

    def limp_of(self, action: Collection[str]) -> list[str]:
        """Return the motors without torque that an action would move: those that it names, and those
        without a key of the robot (wheels), which any action may move."""
        features = self.action_features if self.limp else ()
        return sorted(name for name in self.limp if f"{name}.pos" in action or f"{name}.pos" not in features)

    def hold(self) -> str:
        """Make the present positions the goals of all motors with torque, and put the others into ``limp``.
        Return an error text for other failures."""
        self.limp = frozenset()
        return self._each([functools.partial(self._hold, path) for path in self._kind.buses])

    def _hold(self, path: str) -> None:
        bus, prefix = _at(self._robot, path), _prefix(path)
        limp = self._without_torque(path)
        self.limp |= limp
        if motors := [motor for motor in self._goals(bus) if prefix + motor not in limp]:
            bus.sync_write(GOAL, _read(bus, PRESENT, motors), normalize=False)

    def _goals(self, bus: Any) -> list[str]:
        """Return the motors of a bus that have a goal register."""
        return list(getattr(self._robot, self._kind.goals) if self._kind.goals else bus.motors)

    def _without_torque(self, path: str) -> frozenset[str]:
        torque = _read(_at(self._robot, path), TORQUE)
        return frozenset(_prefix(path) + motor for motor, value in torque.items() if not value)

    def stop(self) -> Mapping[str, Any] | None:
        """Make every call that stops this type, even if some fail, and read the torque back."""
        self._energised, self.limp = False, frozenset()
        if not self._robot.is_connected:
            return None
        calls = [functools.partial(self._called, path) for path in self._kind.stops]
        buses = self._buses()
        # LeRobot asks motor by motor, and gives up at the first one that does not answer. So first send
        # one frame per bus to all motors, without waiting for an answer.
        at_once = [functools.partial(_torque_off, bus) for bus in buses]
        failure = self._each([*at_once, *calls])
        # A failure may leave answers on the bus, so one reading of the torque does not prove it then.
        energised = self._each([functools.partial(_limp, bus, 2 if failure else 1) for bus in buses])
        if buses and not energised:
            return None
        failure = "; ".join(filter(None, (failure, energised)))
        return {"status": "error", "content": [{"text": failure}]} if failure else None

    def _called(self, path: str) -> None:
        _at(self._robot, path)()

    def _each(self, calls: Sequence[Any]) -> str:
        failures = []
        for call in calls:
            try:
                call()
            except Exception as error:  # the next call may still reach other motors
                failures.append(f"{type(error).__name__}: {error}")
        return "; ".join(failures)

    def cleanup(self) -> None:
        self._energised = False
        if self._robot.is_connected:
            self._robot.disconnect()

    def descriptors(self) -> list[int]:
        """Return the open serial ports, for a stop channel that knows the bus."""
        return [bus.port_handler.ser.fileno() for bus in self._buses()] if self._kind.wire else []

    def _buses(self) -> list[Any]:
        return [_at(self._robot, path) for path in self._kind.buses]


@contextlib.contextmanager
def _without_torque(bus: Any) -> Iterator[None]:
    """Keep the motors limp while LeRobot configures them. LeRobot would switch the torque on at the end,
    with goals from an earlier time."""
    bus.enable_torque = lambda *args, **keywords: None  # an attribute of this object hides the class's method
    try:
        yield
        bus.disable_torque(num_retry=TRIES)  # the torque may have been on before
    finally:
        del bus.enable_torque


def _forget(bus: Any) -> None:
    """Discard received bytes, since LeRobot would take a late answer for the next one."""
    serial = getattr(getattr(bus, "port_handler", None), "ser", None)
    if serial is not None:
        serial.reset_input_buffer()


def _torque_off(bus: Any) -> None:
    _forget(bus)
    bus.sync_write(TORQUE, dict.fromkeys(bus.motors, 0), normalize=False)


def _read(bus: Any, register: str, motors: Sequence[str] | None = None) -> dict[str, int]:
    """Return a register of each motor, without conversion. Feetech's first protocol cannot read all motors
    with one frame."""
    if getattr(bus, "protocol_version", None) == 1:
        return {
            motor: bus.read(register, motor, num_retry=TRIES, normalize=False) for motor in motors or bus.motors
        }
    values: dict[str, int] = bus.sync_read(register, motors, num_retry=TRIES, normalize=False)
    return values


def _limp(bus: Any, agreeing: int = 1) -> None:
    """Raise ``ConnectionError`` unless all motors report, ``agreeing`` times in a row, that they have no
    torque."""
    seen, why = 0, ""
    for look in range(LOOKS):
        if look:
            time.sleep(LOOK_S)
        _forget(bus)
        try:
            energised = [motor for motor, value in _read(bus, TORQUE).items() if value]
        except ConnectionError as error:
            energised, why = list(bus.motors), str(error)
        else:
            if energised:
                why = f"{', '.join(energised)} still has torque"
        seen = 0 if energised else seen + 1
        if seen == agreeing:
            return
    raise ConnectionError(why)


def _prefix(path: str) -> str:
    """Return the prefix of the robot's keys for the motors of one bus, such as ``left_arm.bus``."""
    side, arm, _ = path.partition("_arm.")
    return f"{side}_" if arm else ""


def _at(thing: Any, path: str) -> Any:
    return functools.reduce(getattr, path.split("."), thing)


def _fields_of(config_class: type[Any]) -> list[str]:
    return [field.name for field in dataclasses.fields(config_class)]


def class_name(robot: str) -> str:
    """Return the name of a robot's class in this module. The robot's processes import it by this name."""
    return "".join(part.capitalize() for part in robot.split("_")) + "Follower"


def class_of(robot: str) -> type[Follower]:
    """Return the class of a robot of ``TYPES``."""
    follower_class: type[Follower] = globals()[class_name(robot)]
    return follower_class


def _made(robot: str) -> type[Follower]:
    kind = TYPES[robot]
    members: dict[str, Any] = {"ROBOT": robot, "__module__": __name__, "__doc__": Follower.__doc__}
    if kind.port:
        members |= {"PORT_KIND": "serial" if kind.serial else "address", "PORT_OPTIONAL": not kind.serial}
    return type(class_name(robot), (Follower,), members)


globals().update({class_name(robot): _made(robot) for robot in TYPES})

__all__ = ["Follower", "Type", "class_of"]

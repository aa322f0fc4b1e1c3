"""Wrap a robot object of LeRobot as a driver class in the form of ``docs/drivers.md``. It runs in the wire process.

LeRobot switches the torque on when it connects. This class keeps it off while it connects, if it can reach the
robot's servo buses. Arming then switches the torque on at the present positions. For robots with other buses,
connecting switches the torque on, as in LeRobot.
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
"""The torque is read once for this many readings of the positions, about ten times a second. A servo that resets
or is overloaded stays without torque for longer. Reading the torque each time would use a third of the bus."""
LIMP = "limp"
"""Fault text of a motor that has lost its torque."""
TRIES = 2
"""Number of retries after a bad answer, within the timeout of the call."""


class Follower:
    """The driver class of one LeRobot robot. ``tool_name`` is LeRobot's ``id``, under which the robot was
    calibrated. Other keywords are fields of LeRobot's config. A nested config is given as a mapping."""

    ROBOT: ClassVar[str]
    DRIVER: ClassVar[str] = "strands_actors.drivers.plain.lerobot.driver:LeRobotDriver"

    def __init__(self, port: str | None = None, tool_name: str | None = None, **fields: Any) -> None:
        fields.pop("data_config", None)
        self._robot_type = robot_type = TYPES[self.ROBOT]
        if port is not None and not robot_type.port:
            raise ValueError(
                f"{robot_type.type} has no single port. Give the fields of its config instead: "
                "left_arm_config={...}"
            )
        self._fields = {"id": tool_name, **fields, **({robot_type.port: port} if port is not None else {})}
        self._robot = self._make()
        self._energised = False
        self._readings = 0
        self.limp: frozenset[str] = frozenset()
        """Motors that were energised, and had no torque at the last reading."""

    def _make(self) -> Any:
        # LeRobot depends on draccus, and parses its command line with it.
        import draccus

        robots = importlib.import_module("lerobot.robots")
        importlib.import_module(f"lerobot.robots.{self._robot_type.module}")
        config_class = robots.RobotConfig.get_choice_class(self._robot_type.type)
        fields = _fields_of(config_class)
        if unknown := [name for name in self._fields if name not in fields]:
            raise ValueError(f"{self._robot_type.type} has no option {', '.join(unknown)}. Use {', '.join(fields)}")
        own = {"cameras": {}, "use_degrees": True, "disable_torque_on_disconnect": True}
        config = {name: value for name, value in own.items() if name in fields} | self._fields
        return robots.make_robot_from_config(draccus.decode(config_class, config))

    @property
    def action_features(self) -> Mapping[str, Any]:
        features: Mapping[str, Any] = self._robot.action_features
        return features

    @property
    def is_connected(self) -> bool:
        """Return True if the robot is connected and energised. After a stop this is False."""
        return self._energised and bool(self._robot.is_connected)

    def connect(self) -> None:
        """Connect at the first call, without torque if possible. At the next call, switch the torque on at the
        present position."""
        robot, robot_type = self._robot, self._robot_type
        if robot.is_connected and robot_type.holds:
            self._energise()
            return
        # The robot was stopped. Only a new connection switches its torque on.
        if robot.is_connected:
            robot.disconnect()
        with contextlib.ExitStack() as stack:
            for bus in self._buses():
                stack.enter_context(_without_torque(bus))
            robot.connect(**({"calibrate": False} if "calibrate" in signature(robot.connect).parameters else {}))
        if not robot.is_calibrated:
            robot.disconnect()
            raise ConnectionError(
                f"{robot_type.type} {self._fields['id']!r} is not calibrated as its motors are. Run "
                f"lerobot-calibrate --robot.type={robot_type.type} --robot.id={self._fields['id']}"
            )
        if not robot_type.holds:
            self._energised = True
        elif failure := self._each([functools.partial(_limp, bus) for bus in self._buses()]):
            raise ConnectionError(failure)

    def _energise(self) -> None:
        for bus in self._buses():
            motors = self._goals(bus)
            # With the goal of an earlier session the arm would jump.
            bus.sync_write(GOAL, _read(bus, PRESENT, motors), normalize=False)
            bus.enable_torque(num_retry=TRIES)
        self._energised, self._readings, self.limp = True, 0, frozenset()

    def get_observation(self) -> Mapping[str, Any]:
        observed: Mapping[str, Any] = self._robot.get_observation()
        if self._energised and self._robot_type.holds:
            self._readings += 1
            if self._readings % TORQUE_EVERY == 0:
                self.limp = frozenset(
                    name for path in self._robot_type.buses for name in self._without_torque(path)
                )
        return observed

    def send_action(self, action: Mapping[str, float]) -> None:
        """Send an action.

        Raises:
            RuntimeError: The action would move a motor that has no torque. On an STS3215 the goal would switch the
                torque on again.
        """
        if limp := self.limp_of(action):
            raise RuntimeError(f"{', '.join(limp)} has no torque")
        self._robot.send_action(dict(action))

    def limp_of(self, action: Collection[str]) -> list[str]:
        """Return the motors without torque that an action would move. These are the motors that the action names.
        Wheels have no key in an action, so any action may move them."""
        features = self.action_features if self.limp else ()
        return sorted(name for name in self.limp if f"{name}.pos" in action or f"{name}.pos" not in features)

    def hold(self) -> str:
        """Make the motors with torque hold their present positions. Store the names of the others in ``self.limp``.
        Return an error text if a bus fails."""
        self.limp = frozenset()
        return self._each([functools.partial(self._hold, path) for path in self._robot_type.buses])

    def _hold(self, path: str) -> None:
        bus, prefix = _attribute_at(self._robot, path), _prefix(path)
        limp = self._without_torque(path)
        self.limp |= limp
        if motors := [motor for motor in self._goals(bus) if prefix + motor not in limp]:
            bus.sync_write(GOAL, _read(bus, PRESENT, motors), normalize=False)

    def _goals(self, bus: Any) -> list[str]:
        """Return the motors of a bus that have a goal register."""
        return list(getattr(self._robot, self._robot_type.goals) if self._robot_type.goals else bus.motors)

    def _without_torque(self, path: str) -> frozenset[str]:
        torque = _read(_attribute_at(self._robot, path), TORQUE)
        return frozenset(_prefix(path) + motor for motor, value in torque.items() if not value)

    def stop(self) -> Mapping[str, Any] | None:
        """Call all functions that stop this type of robot, even if some fail. Then read the torque of all motors to
        confirm the stop."""
        self._energised, self.limp = False, frozenset()
        if not self._robot.is_connected:
            return None
        calls = [functools.partial(self._called, path) for path in self._robot_type.stops]
        buses = self._buses()
        # LeRobot switches off one motor after the other, and gives up at the first motor that does not answer. So
        # first send one frame per bus that reaches all motors, without waiting for an answer.
        at_once = [functools.partial(_torque_off, bus) for bus in buses]
        failure = self._each([*at_once, *calls])
        # After a failure, replies may still be on the bus. Then two readings in a row must show that there is no
        # torque.
        energised = self._each([functools.partial(_limp, bus, 2 if failure else 1) for bus in buses])
        if buses and not energised:
            return None
        failure = "; ".join(filter(None, (failure, energised)))
        return {"status": "error", "content": [{"text": failure}]} if failure else None

    def _called(self, path: str) -> None:
        _attribute_at(self._robot, path)()

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
        """Return the descriptors of the open serial ports, if this package's own driver can stop the robot by
        them."""
        return [bus.port_handler.ser.fileno() for bus in self._buses()] if self._robot_type.wire else []

    def _buses(self) -> list[Any]:
        return [_attribute_at(self._robot, path) for path in self._robot_type.buses]


@contextlib.contextmanager
def _without_torque(bus: Any) -> Iterator[None]:
    """Keep the torque off while LeRobot configures the motors. LeRobot would switch it on at the end, and the
    motors would move to the goals of an earlier session."""
    # An attribute of this object replaces the method of its class.
    bus.enable_torque = lambda *args, **keywords: None
    try:
        yield
        bus.disable_torque(num_retry=TRIES)  # the torque may already be on from an earlier session
    finally:
        del bus.enable_torque


def _forget(bus: Any) -> None:
    """Discard the bytes that were received, since LeRobot would take a late reply for the reply to its next
    request."""
    serial = getattr(getattr(bus, "port_handler", None), "ser", None)
    if serial is not None:
        serial.reset_input_buffer()


def _torque_off(bus: Any) -> None:
    _forget(bus)
    bus.sync_write(TORQUE, dict.fromkeys(bus.motors, 0), normalize=False)


def _read(bus: Any, register: str, motors: Sequence[str] | None = None) -> dict[str, int]:
    """Return the raw value of a register of each motor. Feetech's first protocol version has no frame that reads
    all motors, so it reads them one by one."""
    if getattr(bus, "protocol_version", None) == 1:
        return {
            motor: bus.read(register, motor, num_retry=TRIES, normalize=False) for motor in motors or bus.motors
        }
    values: dict[str, int] = bus.sync_read(register, motors, num_retry=TRIES, normalize=False)
    return values


def _limp(bus: Any, agreeing: int = 1) -> None:
    """Raise ``ConnectionError`` unless all motors report that they have no torque. ``agreeing`` is the number of
    readings in a row that must show it."""
    limp_readings, reason = 0, ""
    for look in range(LOOKS):
        if look:
            time.sleep(LOOK_S)
        _forget(bus)
        try:
            energised = [motor for motor, value in _read(bus, TORQUE).items() if value]
        except ConnectionError as error:
            energised, reason = list(bus.motors), str(error)
        else:
            if energised:
                reason = f"{', '.join(energised)} still has torque"
        limp_readings = 0 if energised else limp_readings + 1
        if limp_readings == agreeing:
            return
    raise ConnectionError(reason)


def _prefix(path: str) -> str:
    """Return the prefix of the keys of one bus's motors. It is ``left_`` for the bus ``left_arm.bus``, and empty
    for a robot with one arm."""
    side, arm, _ = path.partition("_arm.")
    return f"{side}_" if arm else ""


def _attribute_at(thing: Any, path: str) -> Any:
    return functools.reduce(getattr, path.split("."), thing)


def _fields_of(config_class: type[Any]) -> list[str]:
    return [field.name for field in dataclasses.fields(config_class)]


def class_name(robot: str) -> str:
    """Return the name that the class of a robot has in this module. Other processes import the class by this
    name."""
    return "".join(part.capitalize() for part in robot.split("_")) + "Follower"


def class_of(robot: str) -> type[Follower]:
    """Return the ``Follower`` class of a robot of ``TYPES``."""
    follower_class: type[Follower] = globals()[class_name(robot)]
    return follower_class


def _made(robot: str) -> type[Follower]:
    robot_type = TYPES[robot]
    members: dict[str, Any] = {"ROBOT": robot, "__module__": __name__, "__doc__": Follower.__doc__}
    if robot_type.port:
        members |= {
            "PORT_KIND": "serial" if robot_type.serial else "address",
            "PORT_OPTIONAL": not robot_type.serial,
        }
    return type(class_name(robot), (Follower,), members)


globals().update({class_name(robot): _made(robot) for robot in TYPES})

__all__ = ["Follower", "Type", "class_of"]

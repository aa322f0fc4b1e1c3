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
import os
from collections.abc import Collection, Mapping, Sequence
from inspect import signature
from typing import Any, ClassVar

from . import bus_access
from .bus_access import GOAL, PRESENT, TORQUE, TRIES
from .descriptors import descriptors_of, devices_in
from .types import TYPES, Type

TORQUE_EVERY = 3
"""The torque is read once for this many readings of the positions, about ten times a second. A servo that resets
or is overloaded stays without torque for longer. Reading the torque each time would use a third of the bus."""
LIMP = "limp"
"""Fault text of a motor that has lost its torque."""


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
        self._devices: frozenset[int] = frozenset()
        """The serial devices of the robot, as they were when it was connected. An unplugged one has no path."""
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
        self._devices = devices_in(self._fields)
        with contextlib.ExitStack() as stack:
            for bus in self._buses():
                stack.enter_context(bus_access.without_torque(bus))
            robot.connect(**({"calibrate": False} if "calibrate" in signature(robot.connect).parameters else {}))
        if not robot.is_calibrated:
            robot.disconnect()
            raise ConnectionError(
                f"{robot_type.type} {self._fields['id']!r} is not calibrated as its motors are. Run "
                f"lerobot-calibrate --robot.type={robot_type.type} --robot.id={self._fields['id']}"
            )
        if not robot_type.holds:
            self._energised = True
        elif failure := self._each([functools.partial(self._limp, bus) for bus in self._buses()]):
            raise ConnectionError(failure)

    def _energise(self) -> None:
        for bus in self._buses():
            motors = self._goals(bus)
            # With the goal of an earlier session the arm would jump.
            bus.sync_write(GOAL, bus_access.read(bus, PRESENT, motors), normalize=False)
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
            bus.sync_write(GOAL, bus_access.read(bus, PRESENT, motors), normalize=False)

    def _goals(self, bus: Any) -> list[str]:
        """Return the motors of a bus that have a goal register."""
        return list(getattr(self._robot, self._robot_type.goals) if self._robot_type.goals else bus.motors)

    def _without_torque(self, path: str) -> frozenset[str]:
        torque = bus_access.read(_attribute_at(self._robot, path), TORQUE)
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
        at_once = [functools.partial(self._torque_off, bus) for bus in buses]
        failure = self._each([*at_once, *calls])
        # After a failure, replies may still be on the bus. Then two readings in a row must show that there is no
        # torque.
        energised = self._each([functools.partial(self._limp, bus, 2 if failure else 1) for bus in buses])
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
        them. They do not block from then on."""
        ports = descriptors_of(self._devices) if self._robot_type.wire else []
        for descriptor in ports:
            # The process that stops the robot uses a duplicate, which shares this mode. It must never wait for a
            # byte. rustypot opens its port so that a read would wait.
            os.set_blocking(descriptor, False)
        return ports

    def _limp(self, bus: Any, agreeing: int = 1) -> None:
        bus_access.require_limp(bus, descriptors_of(self._devices), agreeing)

    def _torque_off(self, bus: Any) -> None:
        bus_access.torque_off(bus, descriptors_of(self._devices))

    def _buses(self) -> list[Any]:
        return [_attribute_at(self._robot, path) for path in self._robot_type.buses]


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

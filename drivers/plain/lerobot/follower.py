"""An object of LeRobot's, in the wire process, as a driver class of the drivers page.

LeRobot energises a robot when it connects it. This does not leave it so: connected, it has no
torque, and is energised where it stands when the tree arms it. That is so where it has buses whose
torque can be kept off meanwhile; others are energised by connecting, as LeRobot has it.
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
"""LeRobot's names of the registers."""
LOOKS, LOOK_S = 4, 0.03
"""How often the torque is read back, and how long answers have to be late in between."""
TORQUE_EVERY = 3
"""Readings of the positions to one of the torque: a tenth of a second at 30 a second. A servo that
resets or is overloaded is limp for longer; asked each time, it would cost a third of the bus."""
LIMP = "limp"
"""What is said of a motor that has lost its torque."""
TRIES = 2
"""Of one that answers badly; a deadline is behind them all."""


class Follower:
    """``tool_name``: LeRobot's ``id``, under which it was calibrated. Other keywords are fields of
    its config, mappings where that has configs of its own."""

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
        """Motors that were energised, and had no torque when they were asked last."""

    def _make(self) -> Any:
        import draccus  # LeRobot's own; what it reads its command line with

        robots = importlib.import_module("lerobot.robots")
        importlib.import_module(f"lerobot.robots.{self._kind.module}")
        config_class = robots.RobotConfig.get_choice_class(self._kind.type)
        known = _fields_of(config_class)
        if unknown := [name for name in self._fields if name not in known]:
            raise ValueError(f"{self._kind.type} has no {', '.join(unknown)}. it has {', '.join(known)}")
        own = {"cameras": {}, "use_degrees": True, "disable_torque_on_disconnect": True}
        given = {name: value for name, value in own.items() if name in known} | self._fields
        return robots.make_robot_from_config(draccus.decode(config_class, given))

    @property
    def action_features(self) -> Mapping[str, Any]:
        features: Mapping[str, Any] = self._robot.action_features
        return features

    @property
    def is_connected(self) -> bool:
        """Whether it may be commanded; a stop ends that."""
        return self._energised and bool(self._robot.is_connected)

    def connect(self) -> None:
        """First connect, without torque where that can be had; after that energise it where it
        is."""
        robot, kind = self._robot, self._kind
        if robot.is_connected and kind.holds:
            self._energise()
            return
        if robot.is_connected:  # it was stopped, and only connecting energises it
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
        """Raise ``RuntimeError`` for one that moves a motor without torque: on an STS3215 a goal
        turns it on."""
        if limp := self.limp_of(action):
            raise RuntimeError(f"{', '.join(limp)} has no torque")
        self._robot.send_action(dict(action))

    def limp_of(self, action: Collection[str]) -> list[str]:
        """Return which motors without torque an action would move: those that it names, and those
        that are no key of the robot's (wheels), which any may."""
        known = self.action_features if self.limp else ()
        return sorted(name for name in self.limp if f"{name}.pos" in action or f"{name}.pos" not in known)

    def hold(self) -> str:
        """Make the present positions the goals of those that have torque; ``limp`` are the others.
        Return what else went wrong."""
        self.limp = frozenset()
        return self._each([functools.partial(self._hold, path) for path in self._kind.buses])

    def _hold(self, path: str) -> None:
        bus, prefix = _at(self._robot, path), _prefix(path)
        limp = self._without_torque(path)
        self.limp |= limp
        if motors := [motor for motor in self._goals(bus) if prefix + motor not in limp]:
            bus.sync_write(GOAL, _read(bus, PRESENT, motors), normalize=False)

    def _goals(self, bus: Any) -> list[str]:
        """Return the motors of a bus that have goals."""
        return list(getattr(self._robot, self._kind.goals) if self._kind.goals else bus.motors)

    def _without_torque(self, path: str) -> frozenset[str]:
        torque = _read(_at(self._robot, path), TORQUE)
        return frozenset(_prefix(path) + motor for motor, value in torque.items() if not value)

    def stop(self) -> Mapping[str, Any] | None:
        """Do all that the type is stopped by, whatever fails of it, and read the torque back."""
        self._energised, self.limp = False, frozenset()
        if not self._robot.is_connected:
            return None
        calls = [functools.partial(self._called, path) for path in self._kind.stops]
        buses = self._buses()
        # LeRobot asks motor by motor, and ends at the first that does not answer. This is one frame
        # a bus, for all, which no answer is waited for.
        at_once = [functools.partial(_torque_off, bus) for bus in buses]
        failure = self._each([*at_once, *calls])
        # A bus on which something failed may be out of step: one look is no proof then.
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
            except Exception as error:  # the next one may reach other motors
                failures.append(f"{type(error).__name__}: {error}")
        return "; ".join(failures)

    def cleanup(self) -> None:
        self._energised = False
        if self._robot.is_connected:
            self._robot.disconnect()

    def descriptors(self) -> list[int]:
        """Return the open serial ports, for the stop channel of who knows the bus."""
        return [bus.port_handler.ser.fileno() for bus in self._buses()] if self._kind.wire else []

    def _buses(self) -> list[Any]:
        return [_at(self._robot, path) for path in self._kind.buses]


@contextlib.contextmanager
def _without_torque(bus: Any) -> Iterator[None]:
    """LeRobot configures motors without torque, and gives it back at the end, whatever goal of an
    earlier time they have. Here they keep being limp."""
    bus.enable_torque = lambda *args, **keywords: None  # of this object, before its class's own
    try:
        yield
        bus.disable_torque(num_retry=TRIES)  # as it may have been found
    finally:
        del bus.enable_torque


def _forget(bus: Any) -> None:
    """Throw away what has come in: LeRobot would take an answer that was late for the next one."""
    serial = getattr(getattr(bus, "port_handler", None), "ser", None)
    if serial is not None:
        serial.reset_input_buffer()


def _torque_off(bus: Any) -> None:
    _forget(bus)
    bus.sync_write(TORQUE, dict.fromkeys(bus.motors, 0), normalize=False)


def _read(bus: Any, register: str, motors: Sequence[str] | None = None) -> dict[str, int]:
    """Return a register of each motor as it is. Feetech's first protocol has no frame that asks for
    all at once."""
    if getattr(bus, "protocol_version", None) == 1:
        return {
            motor: bus.read(register, motor, num_retry=TRIES, normalize=False) for motor in motors or bus.motors
        }
    found: dict[str, int] = bus.sync_read(register, motors, num_retry=TRIES, normalize=False)
    return found


def _limp(bus: Any, agreeing: int = 1) -> None:
    """Raise ``ConnectionError`` unless all motors say, ``agreeing`` times in a row, that they have no
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
    """Return what the robot's keys have before the motors of one of its buses: ``left_arm.bus``."""
    side, arm, _ = path.partition("_arm.")
    return f"{side}_" if arm else ""


def _at(thing: Any, path: str) -> Any:
    return functools.reduce(getattr, path.split("."), thing)


def _fields_of(config_class: type[Any]) -> list[str]:
    return [field.name for field in dataclasses.fields(config_class)]


def class_name(robot: str) -> str:
    """Return the name of a robot's class here, which its processes find it by."""
    return "".join(part.capitalize() for part in robot.split("_")) + "Follower"


def class_of(robot: str) -> type[Follower]:
    """Return the class of a robot of ``TYPES``."""
    found: type[Follower] = globals()[class_name(robot)]
    return found


def _made(robot: str) -> type[Follower]:
    kind = TYPES[robot]
    members: dict[str, Any] = {"ROBOT": robot, "__module__": __name__, "__doc__": Follower.__doc__}
    if kind.port:
        members |= {"PORT_KIND": "serial" if kind.serial else "address", "PORT_OPTIONAL": not kind.serial}
    return type(class_name(robot), (Follower,), members)


globals().update({class_name(robot): _made(robot) for robot in TYPES})

__all__ = ["Follower", "Type", "class_of"]

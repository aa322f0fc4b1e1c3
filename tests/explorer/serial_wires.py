"""Name the wires at serial ports that the kit of ``twin_robot.py`` models: driver, twin, and what moves it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from strands_actors.drivers.common.servo import stop_channel as servo_stop
from strands_actors.drivers.common.twin import Exchange
from strands_actors.drivers.stretch import stop_channel as stretch_stop
from strands_actors.drivers.stretch.twin import world as stretch_world
from strands_actors.drivers.stretch.twin.boards import DeviceDecoder
from strands_actors.drivers.stretch.twin.server import decoders_of

from .plant import Joints
from .robot_model import Actions, replaced
from .serial_robot import BITS_PER_S, Device, SerialRobot
from .service_robot import GOLDEN

FOLDER = "/no/such/stretch-twin"


class DriveActions:
    """Drives with a unique speed, and lifts a little."""

    def __init__(self, lift_m: float) -> None:
        self._lift_m = lift_m
        self._given = 0

    def next(self, far: bool) -> dict[str, float]:
        self._given += 1
        action = {"vx": 0.02 + 0.1 * ((GOLDEN * self._given) % 1.0), "lift": self._lift_m + 1e-4 * self._given}
        return {**action, "wz": 0.1} if far else action


class _Board(NamedTuple):
    """A board or a chain of servos of a Stretch."""

    decoder: DeviceDecoder

    def exchanges(self, data: bytes) -> Iterator[Exchange]:
        for frame in self.decoder.frames(data, BITS_PER_S):
            yield frame.act()


class Boards(SerialRobot):
    """Boards and chains of servos, each at a port: a Stretch. It follows commands from the first goal of any board
    or servo until all of them are stopped."""

    PORT = FOLDER
    DRIVER = "strands_actors.drivers.stretch.driver:Stretch"
    MARK = "vx"
    SETTLE_S = 9.0
    ADOPTERS = (stretch_stop, servo_stop)

    def make_twin(self) -> None:
        with replaced(stretch_world, "Plant", lambda spec, joints, *_: Joints(joints)):
            self.twin = stretch_world.World(self.robot, self.now_s)

    def devices(self) -> dict[str, Device]:
        decoders = decoders_of(self.twin)
        return {f"{FOLDER}/{name}": _Board(decoder) for name, (decoder, _) in decoders.items()}

    def actions(self) -> Actions:
        return DriveActions(self.twin.metres("lift"))

    def told(self, key: str, value: float) -> tuple[int, float]:
        """Return motor 0 for the speed to a side. The service ``set_twist`` names it, and the base lacks it."""
        return (0, value) if key == "vy" else super().told(key, value)

    @property
    def follows_commands(self) -> bool:
        return not self.twin.safe_state

    def pass_time(self) -> None:
        self.twin.pass_time()
        for bus in self.twin.chains:
            bus.pass_time()

    def switch_off_and_on(self) -> None:
        self.twin.power_cycle()

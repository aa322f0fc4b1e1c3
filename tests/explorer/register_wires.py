"""Name the wires with requests and replies that the kit of ``twin_robot.py`` models: driver, twin, and what moves
it."""

from __future__ import annotations

from typing import Any

from strands_actors.drivers.common.twin.tcp import Handler, answering
from strands_actors.drivers.kinova import stop_channel as kinova_stop
from strands_actors.drivers.kinova.twin import KortexSession
from strands_actors.drivers.kinova.twin import twin_of as kinova_twin
from strands_actors.drivers.robotiq.sessions import TcpSession
from strands_actors.drivers.robotiq.twin import twin_of as robotiq_twin

from .robot_model import Actions, Seam
from .service_robot import GOLDEN
from .session_arm import ArmPlant, SlowActions
from .shared_connection import adopting_seams
from .stream_robot import StreamRobot


class SpeedArm(StreamRobot):
    """Frames with protobuf over TCP: a Kinova Gen3, which keeps a speed until the next stop. Its root shares the
    connection of the wire."""

    PORT = "192.0.2.19"
    DRIVER = "strands_actors.drivers.kinova.driver:Kinova"
    MARK = "joint_7"
    SETTLE_S = 6.0  # a stop tries for 1.2 s

    def make_twin(self) -> None:
        plant: Any = ArmPlant(self.driver.axes, 1.0)
        self.twin = kinova_twin(self.robot, now_s=self.now_s, plant=plant)

    def handler(self) -> Handler:
        return answering(lambda: KortexSession(self.twin))

    def actions(self) -> Actions:
        return SlowActions(self.world.rng("actions"), self.MARK, "joint_1", "joint_3", unit=0.5)

    def seams(self) -> tuple[Seam, ...]:
        return (*super().seams(), *adopting_seams(self.network, kinova_stop))

    @property
    def follows_commands(self) -> bool:
        return self.twin.base.driven

    def pass_time(self) -> None:
        self.twin.base.advance()

    def switch_off_and_on(self) -> None:
        self.twin.power_cycle()


class GripActions:
    """Actions with a unique opening of the fingers."""

    def __init__(self) -> None:
        self._given = 0

    def next(self, far: bool) -> dict[str, float]:
        self._given += 1
        return {"gripper": (GOLDEN * self._given) % 1.0}


class Fingers(StreamRobot):
    """Modbus over TCP: a Robotiq gripper. It follows commands from an activation or a goal until the next hold."""

    PORT = "192.0.2.20"
    DRIVER = "strands_actors.drivers.robotiq.driver:Robotiq"
    MARK = "gripper"
    SETTLE_S = 6.0

    def make_twin(self) -> None:
        self.twin = robotiq_twin(self.robot, self.now_s, activation_s=0.1)

    def handler(self) -> Handler:
        return answering(lambda: TcpSession(self.twin))

    def actions(self) -> Actions:
        return GripActions()

    @property
    def follows_commands(self) -> bool:
        return self.twin.gripper.driven

    def pass_time(self) -> None:
        self.twin.gripper.pass_time()

    def switch_off_and_on(self) -> None:
        self.twin.power_cycle()

"""Name the wires of datagrams that the kit of ``twin_robot.py`` models: driver, twin, and what moves it."""

from __future__ import annotations

from typing import ClassVar

from strands_actors.drivers.crazyflie import links as crazyflie_links
from strands_actors.drivers.crazyflie.config import UDP_PORT
from strands_actors.drivers.crazyflie.robots import TABLES as CRAZYFLIES
from strands_actors.drivers.crazyflie.twin.firmware import Firmware
from strands_actors.drivers.kuka import config as kuka_config
from strands_actors.drivers.kuka import stop_channel as kuka_stop
from strands_actors.drivers.kuka.protocol import FRI_PORT, Command, State, decode_command, encode_monitoring
from strands_actors.drivers.kuka.robots import arm_of as kuka_arm
from strands_actors.drivers.kuka.twin import controller as kuka_controller
from tests.memory_udp import Address, Datagram

from .datagram_robot import DatagramRobot
from .robot_model import Actions, Seam
from .session_arm import SlowActions
from .tcp_network import OURS

SESSION_ANSWERS = {"FAIR_AFTER": 1, "GOOD_AFTER": 3, "EXCELLENT_AFTER": 6, "MIRRORED": 5}
"""Number of answers after which a KUKA controller enters each state of a session."""


class CycleArm(DatagramRobot):
    """A session of datagrams: a KUKA iiwa, which gets an answer in each cycle of its controller. It counts as
    energised while the answers move it."""

    PORT = "192.0.2.14"
    ADDRESS: ClassVar[Address] = (PORT, FRI_PORT)
    OPENERS = ((kuka_config, "listen_udp"),)
    ADOPTERS = (kuka_stop,)
    DRIVER = "strands_actors.drivers.kuka.driver:Kuka"
    MARK = "joint7"
    SETTLE_S = 6.0

    def make_twin(self) -> None:
        self.controller = kuka_controller.Controller(kuka_arm(self.robot), now_s=self.now_s)
        self._answer: tuple[Datagram, Command] | None = None  # of this cycle
        self._sent: dict[int, tuple[float, ...]] = {}  # positions in all answers, by number
        self._accepted = 0
        self._moves = False

    def actions(self) -> Actions:
        return SlowActions(self.world.rng("actions"), self.MARK, "joint1", "joint3")

    @property
    def follows_commands(self) -> bool:
        return self._moves

    def sent(self, datagram: Datagram) -> None:
        command = decode_command(datagram.data)
        self._sent[command.sequence] = command.position

    def take(self, datagram: Datagram) -> None:
        command = decode_command(datagram.data)
        self.controller.take_answer(command)
        self._answer = datagram, command

    def pass_time(self) -> None:
        """Run one cycle. A frame is an answer that the controller accepts.

        It is a setpoint if it moves the arm. A hold repeats the previous answer, and moves the arm only if that
        answer was lost.
        """
        controller, answer = self.controller, self._answer
        before, was = controller.commanded, controller.state
        message = controller.cycle()
        moved = was == controller.state == State.COMMANDING_ACTIVE and controller.commanded != before
        self._moves = False
        if answer is not None and self._accepted != message.reflected == answer[1].sequence:
            datagram, command = answer
            self._moves = moved and command.position != self._sent.get(command.sequence - 1, before)
            kind, safe_state = ("setpoint", "") if self._moves else ("safe", "hold")
            self.note_frame(kind, safe_state, datagram.role, datagram.left_s)
        self._answer, self._accepted = None, message.reflected
        self.send(encode_monitoring(message), (OURS, FRI_PORT))

    def switch_off_and_on(self) -> None:
        self.controller.wake_up()
        self._moves = False

    def seams(self) -> tuple[Seam, ...]:
        """Let a session accept commands after a tenth of the usual time, because a run is short."""
        return (*super().seams(), *((kuka_controller, name, answers) for name, answers in SESSION_ANSWERS.items()))


class RadioDrone(DatagramRobot):
    """Radio packets: a Crazyflie behind the bridge of its radio. It counts as energised while its motors run."""

    PORT = "udp://192.0.2.15"
    ADDRESS: ClassVar[Address] = ("192.0.2.15", UDP_PORT)
    OPENERS = ((crazyflie_links, "open_udp"),)
    DRIVER = "strands_actors.drivers.crazyflie.driver:Crazyflie"
    FIRST = (("takeoff", {"height": 0.2, "duration": 0.5}),)
    MARK = "vx"
    SETTLE_S = 25.0  # a landing is tried for 9 s

    def make_twin(self) -> None:
        self.firmware = Firmware(CRAZYFLIES.table(self.robot), self.now_s)
        self._listener: Address | None = None  # its reports go to the last sender

    @property
    def follows_commands(self) -> bool:
        return self.firmware.motors_on

    def take(self, datagram: Datagram) -> None:
        self._listener = datagram.sender
        self.firmware.pass_time()
        reaction = self.firmware.receive(datagram.data)
        self.note_frame(reaction.kind, reaction.safe_state, datagram.role, datagram.left_s)
        for reply in reaction.replies:
            self.send(reply, datagram.sender)

    def pass_time(self) -> None:
        self.firmware.pass_time()
        if self._listener is not None:
            for report in self.firmware.reports():
                self.send(report, self._listener)

    def switch_off_and_on(self) -> None:
        self.firmware.reset()

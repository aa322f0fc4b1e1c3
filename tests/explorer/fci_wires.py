"""Model a Franka arm: requests over TCP, and 1 000 states a second over UDP, which a process of the driver answers.

That process runs the product's own turns as a simulated process, ``cycle``, which ends with the wire process. A
setpoint is noted once, with the first of its commands that the controller takes. It counts as written when the wire
process wrote it, because the commands that follow are computed from it.
"""

from __future__ import annotations

import os
import random
import socket
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, ClassVar

import msgspec
import trio

from strands_actors.drivers.common.twin import Connection
from strands_actors.drivers.common.twin.tcp import Handler
from strands_actors.drivers.franka import client, cycle
from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka import wire as franka_wire
from strands_actors.drivers.franka.arms import HOME_RAD, arm_of
from strands_actors.drivers.franka.generator import Limits
from strands_actors.drivers.franka.twin import controller as franka_controller
from strands_actors.drivers.franka.twin.server import IDLE_TICKS, FrankaServer, FrankaTwin
from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.health.heartbeat import Heartbeat, words_of
from tests.memory_udp import Address, Datagram

from .children import EXECUTED_S, SimChild
from .datagram_socket import DatagramNetwork, DatagramSocket
from .links import socket_pair
from .plant import Joints
from .robot_model import Actions, Seam, replaced
from .session_arm import STEP_RAD
from .stream_robot import StreamRobot
from .world import Process, World

TICK_S = franka_controller.TICK_S
FAR_RAD = 0.5
SILENT_S = cycle.SILENT_MS / 1e3
IDENTITY = tuple(float(row == column) for column in range(4) for row in range(4))


class ArmJoints(Joints):
    """Joints that begin at home, and move without effort."""

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__(names)
        self.position_rad, self.targets_rad = list(HOME_RAD), list(HOME_RAD)

    def push(self, effort_nm: Sequence[float]) -> None:
        """Do nothing: no torque is simulated."""

    def pose_of(self, link: str, offset_m: Sequence[float]) -> tuple[float, ...]:
        return IDENTITY


class WholeActions:
    """Actions that name all joints: the last one has a unique angle, and the first one swings around home. A single
    command also turns the third one, which takes up to a second."""

    def __init__(self, keys: Sequence[str], rng: random.Random) -> None:
        self._keys = tuple(keys)
        self._rng = rng
        self._given = 0

    def next(self, far: bool) -> dict[str, float]:
        self._given += 1
        action = dict(zip(self._keys, HOME_RAD, strict=True))
        action[self._keys[-1]] += 1e-4 * self._given
        action[self._keys[0]] += abs((STEP_RAD * self._given + 0.4) % 1.6 - 0.8) - 0.4
        if far:
            action[self._keys[2]] += self._rng.uniform(-FAR_RAD, FAR_RAD)
        return action


class StateSocket(DatagramSocket):
    """The socket for states, which the wire process opens and passes to the process of the cycle."""

    def bind(self, address: Address) -> None:
        """Do nothing: this socket has its port already."""

    def connect(self, address: Address) -> None:
        """Do nothing: no other peer sends to this socket."""

    def __enter__(self) -> StateSocket:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class StateNetwork(DatagramNetwork):
    SOCKET = StateSocket

    def open(self, type: int) -> Any:
        """As ``socket.socket``."""
        return self.open_udp_socket()


class Server(FrankaServer):
    """The twin's server, on connections and datagrams in memory."""

    def __init__(self, robot: FciArm) -> None:  # not its own: that opens sockets
        arm = arm_of(robot.robot)
        plant = SimpleNamespace(from_table=lambda _: ArmJoints(arm.keys))
        with replaced(franka_controller, "Plant", plant):
            self.controller = franka_controller.Controller(arm, arm.fci)
        self.commands: deque[Datagram] = deque()
        self._arm = robot
        self._twin = FrankaTwin(self.controller)
        self._listeners_of_state: dict[Connection, Address] = {}
        self._mover = None
        self._hand = None
        self._late = deque()
        self._log = self._udp = self  # type: ignore[assignment]
        self.serve_client: Handler = self._attend_client

    def step(self) -> None:
        """Run one tick."""
        self._take_commands()
        for _ in range(1 if self.controller.motion is not None else IDLE_TICKS):
            self._tick()

    # -- its socket

    def recv(self, size: int) -> bytes:
        if not self.commands:
            raise BlockingIOError
        return self.commands.popleft().data

    def sendto(self, data: bytes, address: Address) -> None:
        self._arm.send_state(data, address)

    # -- its log

    def write(self, t_ns: int, sender: str, frames: Any, safe_state: str | None = None) -> None:
        if any(kind == "setpoint" for kind, _ in frames):
            self._arm.note_command()


class FciArm(StreamRobot):
    """FCI: a Franka arm, which follows commands while a motion runs."""

    PORT = "192.0.2.21"
    DRIVER = "strands_actors.drivers.franka.driver:Franka"
    MARK = "joint7"
    SETTLE_S = 6.0
    ADDRESS: ClassVar[Address] = (PORT, 40_000)

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot)
        self.states = StateNetwork(world, self.ADDRESS, self._take_command, lambda datagram: None)
        self._aimed_s = self._noted_s = 0.0

    def make_twin(self) -> None:
        self.server = Server(self)

    def handler(self) -> Handler:
        return self.server.serve_client

    def actions(self) -> Actions:
        return WholeActions(self.driver.axes, self.world.rng("actions"))

    def seams(self) -> tuple[Seam, ...]:
        return (
            *super().seams(),
            (client, "socket", SimpleNamespace(socket=self.states.open, SOCK_DGRAM=socket.SOCK_DGRAM)),
            (franka_wire.FrankaSession, "aim", self._noting_aims(franka_wire.FrankaSession.aim)),
            (franka_wire, "start", self._start_cycle),
            (franka_wire, "scheduling_of", lambda pid: ""),
        )

    @property
    def follows_commands(self) -> bool:
        return self.server.controller.motion is not None

    def switch_off_and_on(self) -> None:
        self.server.controller.reset()

    # -- datagrams

    def send_state(self, data: bytes, address: Address) -> None:
        if not self.network.is_cut("in"):
            self.states.send(Datagram(self.world.now_s, "", self.ADDRESS, self.spoil(data)), address)

    def _take_command(self, datagram: Datagram) -> None:
        if not self.network.is_cut("out") and not self.network.stalled:
            self.server.commands.append(datagram)

    def note_command(self) -> None:
        """Note the newest setpoint of the wire process, if it is not noted yet."""
        if self._aimed_s > self._noted_s:
            self._noted_s = self._aimed_s
            self.note_frame("setpoint", None, "wire", self._aimed_s)

    async def _main(self, process: Process) -> None:
        async with trio.open_nursery() as self._nursery:
            due_s = trio.current_time()
            while True:
                ticks = 1 if self.follows_commands else IDLE_TICKS
                # A controller that was stalled does not make up for it.
                due_s = max(due_s + ticks * TICK_S, trio.current_time())
                await trio.sleep_until(due_s)
                self.server.step()
                self.look()

    def _noting_aims(self, aim: Callable[..., None]) -> Callable[..., None]:
        def noting(session: object, goal: tuple[float, ...]) -> None:
            self._aimed_s = self.world.now_s
            aim(session, goal)

        return noting

    # -- the process of the cycle

    def _start_cycle(self, entry: str, args: Mapping[str, Any], pass_fds: Sequence[int]) -> SimChild:
        """As ``start`` of the kernel's processes."""
        parent = self.world.current
        udp, wire = os.dup(args["udp"]), socket.socket(fileno=os.dup(args["wire"]))
        wire.setblocking(False)
        heartbeat = Heartbeat(words_of(args["page"]), cycle.CYCLE_END, cycle.WIRE_END)
        dialect = p.DIALECTS[args["fci"]]
        turns = cycle.Cycle(dialect, msgspec.convert(args["limits"], Limits), heartbeat)
        reporter = cycle.Reporter(dialect, args["stride"])
        boot_s = EXECUTED_S * (0.3 + 0.7 * self.rng.random())

        async def run(process: Process) -> None:
            await trio.sleep(boot_s)
            clock = VirtualClock()
            while True:
                state = b""
                with trio.move_on_after(SILENT_S):
                    await states.readable()
                    state = cycle.newest(states)
                cycle.turn(turns, reporter, state, states, wire, heartbeat, clock.now_ns())

        child = self.world.start("cycle", run, parent)
        states = self.states.inherit(udp, child)
        child.at_end.append(wire.close)
        parent.at_end.append(child.kill)  # as the system does, see ``cycle._end_with``
        return SimChild(child, socket_pair(child, parent)[1])

"""The unitree_go2 of the explorer: the twin's onboard computer and its motors, on a network in memory.

Its sport mode has been released, so its joints carry out each command and keep doing so.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

from strands_actors.contract.loading import load

from .children import SimOs
from .kinds import PEER
from .plan import Event
from .robot_model import Effect, Frame, RobotModel, Seam, nothing, put
from .udp_network import UdpNetwork
from .world import World

HOST = "127.0.0.9"
OURS = "127.0.0.1"
TICK_S = 0.01
"""Period of the state messages. A real robot sends five times as many."""
LATE_S = 0.02
SHARE = 0.3
"""Share of the datagrams that are lost, doubled, or spoiled."""
EMPTY_PCT = 5
FULL_PCT = 80
WEIGHT_NM = 5.0
"""Torque of a motor that carries its share of the robot."""
STEP_RAD = 0.02

# Loaded by name, as the registry loads drivers.
Go2: Any = load("strands_actors.drivers.unitree.driver:Go2Driver")
Onboard: Any = load("strands_actors.drivers.unitree.twin.onboard:Onboard")
safe_state_of: Any = load("strands_actors.drivers.unitree.twin:safe_state_of")
Participant: Any = load("strands_actors.drivers.common.rtps.participant:Participant")
CDR: bytes = load("strands_actors.drivers.common.rtps:CDR")
discovery_port: Any = load("strands_actors.drivers.common.rtps.wire_types:discovery_port")
user_port: Any = load("strands_actors.drivers.common.rtps.wire_types:user_port")
participant_module: Any = import_module("strands_actors.drivers.common.rtps.participant")
link_module: Any = import_module("strands_actors.drivers.unitree.link")
protocol: Any = import_module("strands_actors.drivers.unitree.protocol")
rpc: Any = import_module("strands_actors.drivers.unitree.rpc")
MalformedFrame: Any = load("strands_actors.drivers.common.codecs.malformed:MalformedFrame")
TABLES: Any = load("strands_actors.drivers.unitree.robots:TABLES")


class LegActions:
    """Actions with a different angle of one hip each, while a thigh swings."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._given = 0

    def next(self, far: bool) -> dict[str, float]:
        self._given += 1
        action = {
            "FR_hip_joint": 1e-4 * self._given,
            "FL_thigh_joint": 0.9 + abs((STEP_RAD * self._given + 0.4) % 1.6 - 0.8) - 0.4,
        }
        if far:
            action["FL_hip_joint"] = self._rng.uniform(-0.03, 0.03)
        return action


class Legs:
    """The body: a joint moves where a motor with stiffness pulls it, and otherwise stays."""

    def __init__(self, home_rad: Sequence[float], most: Sequence[tuple[float, float]]) -> None:
        """Stand up. ``most`` is the greatest torque and speed of each joint."""
        self.home_rad = list(home_rad)
        self._most = most
        self.time_s = 0.0
        self.fallen = False
        self.height_m = 0.3
        self.orientation_wxyz = (1.0, 0.0, 0.0, 0.0)
        self.gyro_rad_s = (0.0, 0.0, 0.0)
        self.acceleration_m_s2 = (0.0, 0.0, 9.81)
        self._zero = (0.0,) * len(home_rad)
        self.stand_up()

    def stand_up(self) -> None:
        self.position_rad = list(self.home_rad)
        self.velocity_rad_s = self.effort_nm = self._zero
        self.drive(*(self._zero,) * 5)

    def drive(self, *rows: Sequence[float]) -> None:
        self.q, self.dq, self.tau, self.kp, self.kd = (tuple(row) for row in rows)
        self._feel()

    @property
    def energised(self) -> frozenset[int]:
        rows = enumerate(zip(self.tau, self.kp, self.kd, strict=True), 1)
        return frozenset(motor for motor, gains in rows if any(gains))

    def catch_up(self, now_s: float) -> None:
        passed_s, self.time_s = now_s - self.time_s, now_s
        for at, (_, speed) in enumerate(self._most):
            if self.kp[at]:
                left = self.q[at] - self.position_rad[at]
                self.position_rad[at] += max(-speed * passed_s, min(speed * passed_s, left))
        self._feel()

    def _feel(self) -> None:
        rows = zip(self.q, self.position_rad, self.tau, self.kp, self._most, strict=True)
        self.effort_nm = tuple(
            max(-most, min(most, tau + kp * (q - rad) + WEIGHT_NM)) if tau or kp else 0.0
            for q, rad, tau, kp, (most, _) in rows
        )


class LeggedRobot(RobotModel):
    """A unitree_go2. A joint counts as energised if it gives torque, even if only to brake."""

    PORT = f"{HOST}:7410"
    KEEPS_TORQUE_BY_RESUME = False

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot)
        self.driver_class = Go2
        driver: Any = self.make_driver(Go2)
        self.driver = driver
        model = driver.config.model
        self._motors = {axis.key: at for at, axis in enumerate(driver.table, 1)}
        home_rad = TABLES.table(robot)["home_rad"]
        self.body = Legs(home_rad, [(joint.torque, joint.speed) for joint in model.joints])
        self.onboard = Onboard(model, self._note_of_robot, body=self.body)
        self.network = UdpNetwork(world, HOST, lambda *which: (discovery_port(*which), user_port(*which)))
        self.stalled = False
        self._commands = protocol.CommandCodec(model)
        self._states = protocol.StateCodec(model)
        self._float32 = protocol.struct.Struct("<f")
        self._participant: Any = None
        self._heard = b""
        self._goals: Mapping[int, float] = {}
        self.onboard.soc = FULL_PCT
        self.wake_up()
        world.after(0.0, self._tick)

    def _note_of_robot(self, kind: str, text: str) -> None:
        self.world.note("robot", kind, text)

    def actions(self) -> LegActions:
        return LegActions(self.world.rng("actions"))

    def told(self, key: str, value: float) -> tuple[int, float]:
        return self._motors[key], self._float32.unpack(self._float32.pack(value))[0]

    def marks(self, key: str) -> bool:
        return key == "FR_hip_joint"

    def held_between(self, motor: int, frame: Frame) -> tuple[float, float]:
        """Return no range, because a joint without stiffness is not pulled."""
        return 0.0, 0.0

    def seams(self) -> tuple[Seam, ...]:
        return (
            (participant_module, "open_sockets", self.network.open_sockets),
            (participant_module, "os", SimOs(self.world)),
            (link_module, "own_address", lambda host: OURS),
        )

    def effect(self, event: Event) -> Effect | None:
        network = self.network
        match event.kind:
            case "pull":
                return lambda: network.cut.update(("out", "in")), network.cut.clear
            case "lose requests":
                return lambda: network.cut.add("out"), lambda: network.cut.discard("out")
            case "lose replies":
                return lambda: network.cut.add("in"), lambda: network.cut.discard("in")
            case "drop":
                return put(network, "lost", SHARE, 0.0)
            case "late":
                return put(network, "late_s", LATE_S, 0.0)
            case "twice":
                return put(network, "doubled", SHARE, 0.0)
            case "corrupt":
                return put(network, "spoiled", SHARE, 0.0)
            case "stall":
                return put(self, "stalled", True, False)
            case "brown out":
                return self.brown_out, nothing
            case "low battery":
                return put(self.onboard, "soc", EMPTY_PCT, FULL_PCT)
        return put(network.peer, "kind", event.kind, "") if event.kind in PEER else None

    def mend(self) -> None:
        network = self.network
        network.cut.clear()
        network.lost = network.late_s = network.doubled = network.spoiled = 0.0
        network.peer.kind = ""
        self.stalled = False
        self.onboard.soc = FULL_PCT

    def wake_up(self) -> None:
        """Start lying, with the sport mode released, so that any client may command the joints."""
        self.onboard.reset()
        self.onboard.mode = ""
        self.body.drive(*((0.0,) * len(self._motors),) * 5)

    def brown_out(self) -> None:
        self.wake_up()
        if self._participant is not None:
            for sock in self._own_sockets():
                sock.close()
            self._participant = None
        self.log_energised(self.body.energised)

    # -- the robot's end

    def _tick(self) -> None:
        if self._participant is None:
            self._join()
        if not self.stalled:
            self._poll()
            self.onboard.advance(self.world.now_s)
            self._state_writer.write(CDR + self._states.encode(self.onboard.state()))
        self.world.after(TICK_S, self._tick)

    def _join(self) -> None:
        participant = self._participant = Participant(0, HOST, (), False, clock=WorldClock(self.world))
        family = self.driver.config.model.family
        self._state_writer = participant.writer(protocol.STATE_TOPIC, protocol.state_type(family))
        participant.reader(protocol.COMMAND_TOPIC, protocol.command_type(family), self._on_command)
        service = rpc.MOTION_SWITCHER
        self._answers = participant.writer(rpc.response_topic(service), rpc.RESPONSE_TYPE, reliable=True)
        participant.reader(rpc.request_topic(service), rpc.REQUEST_TYPE, self._on_request, reliable=True)
        for sock in self._own_sockets():
            sock.on_arrival = self._poll
        self._user = self._own_sockets()[1]

    def _own_sockets(self) -> list[Any]:
        return [sock for (host, _), sock in sorted(self.network.sockets.items()) if host == HOST]

    def _poll(self) -> None:
        if not self.stalled and self._participant is not None:
            self._participant.poll()

    def _on_request(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        try:
            request = rpc.decode_request(bytes(payload[4:]))
        except MalformedFrame:
            return
        response = self.onboard.serve(rpc.MOTION_SWITCHER, request)
        if response is not None:
            self._answers.write(CDR + rpc.encode_response(response))

    def _on_command(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        body = bytes(payload[4:])
        try:
            command = self._commands.decode(body)
        except MalformedFrame:
            return
        now_s, datagram = self.world.now_s, self._user.newest
        safe_state, was, before = safe_state_of(command), self.energised_log[-1][1], self._goals
        self.onboard.command(command, now_s)
        kind = "safe" if safe_state else "setpoint"
        again = body == self._heard and bool(self.frames) and self.frames[-1].role == datagram.role
        if not again:
            self._heard = body
            self._goals = {} if safe_state else dict(enumerate(command.q, 1))
            self.world.note("wire", datagram.role, f"{kind} {safe_state} {self._goals}")
        now = self.body.energised
        positions: dict[int, float] = {}
        self.frames.append(
            Frame(
                now_s,
                datagram.left_s,
                datagram.role,
                kind,
                safe_state,
                self._goals,
                before,
                {},
                positions,
                was,
                now,
            )
        )
        self.log_energised(now)


class WorldClock:
    def __init__(self, world: World) -> None:
        self._world = world

    def now_ns(self) -> int:
        return round(self._world.now_s * 1e9)

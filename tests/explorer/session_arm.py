"""The xarm7 of the explorer: the twin's controller with its registers, behind connections in memory."""

from __future__ import annotations

import array
import random
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from strands_actors.contract.loading import load

from .plan import Event
from .plant import Joints
from .robot_model import Effect, Frame, RobotModel, Seam, nothing, put
from .tcp_network import Piece, SimStream, TcpNetwork
from .world import World

TICK_S = 0.01
"""Period of its reports. A real controller computes 250 times a second."""
GARBLED = 0.05
"""Share of replies that are garbled."""
TOLERATED_RAD = 0.02
STEP_RAD = 0.008
"""Step of one joint from setpoint to setpoint: 14 degrees a second."""

# Loaded by name, as the registry loads drivers.
XArm: Any = load("strands_actors.drivers.xarm.driver:XArm")
XArmWire: Any = load("strands_actors.drivers.xarm.wire:XArmWire")
StopChannel: Any = load("strands_actors.drivers.xarm.stop_channel:XArmStopChannel")
controller_of: Any = load("strands_actors.drivers.xarm.twin:controller_of")
ControlSession: Any = load("strands_actors.drivers.xarm.twin:ControlSession")
Publisher: Any = load("strands_actors.drivers.xarm.twin.publisher:Publisher")
Faults: Any = load("strands_actors.drivers.common.twin:Faults")
ClientGone: Any = load("strands_actors.drivers.common.twin:ClientGone")
CONTROL_PORT: int = load("strands_actors.drivers.xarm.protocol:CONTROL_PORT")
SERVO_JOINT: int = load("strands_actors.drivers.xarm.protocol:Register").SERVO_JOINT
HEADER: int = 6
unpack_floats: Any = load("strands_actors.drivers.xarm.protocol:unpack_floats")
floats: Any = load("strands_actors.drivers.xarm.protocol:floats")
LOGGED = frozenset({"setpoint", "safe", "enable"})


class ArmPlant(Joints):
    """Joints with a flange, whose pose is constant and unused."""

    def __init__(self, names: tuple[str, ...], speed_rad_s: float) -> None:
        super().__init__(names, speed_rad_s)
        flange = SimpleNamespace(xpos=array.array("d", bytes(24)), xmat=(1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0))
        self.data = SimpleNamespace(body=lambda name: flange)


class SlowActions:
    """Actions with a unique angle of the joint ``mark``, while the joint ``swing`` swings. Single commands
    also move the joint ``third``.

    Args:
        unit: One radian in the unit of the joints.
        far: Longest way of ``third`` from its middle, in radians.
    """

    def __init__(
        self,
        rng: random.Random,
        mark: str = "joint7",
        swing: str = "joint1",
        third: str = "joint3",
        unit: float = 1.0,
        far: float = 0.015,
    ) -> None:
        self._rng = rng
        self._keys = mark, swing, third
        self._unit = unit
        self._far = far
        self._given = 0

    def next(self, far: bool) -> dict[str, float]:
        self._given += 1
        mark, swing, third = self._keys
        action = {
            mark: self._unit * 1e-4 * self._given,
            swing: self._unit * (abs((STEP_RAD * self._given + 0.4) % 1.6 - 0.8) - 0.4),
        }
        if far:
            action[third] = self._unit * self._rng.uniform(-self._far, self._far)
        return action


class SessionArm(RobotModel):
    """An xarm7. A joint counts as energised if it would follow a target: its motor is on, and its
    controller is not in state 4."""

    PORT = "192.0.2.7"
    SETTLE_S = 5.0  # a connection takes 0.5 s to fail, and a stop 1 s
    KEEPS_TORQUE_BY_RESUME = True

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot)
        self.driver_class = XArm
        self.driver = driver = self.make_driver(XArm)
        self._motors = {axis.key: at for at, axis in enumerate(driver.table, 1)}
        plant = ArmPlant(driver.axes, driver.table[0].speed or 0.0)
        self.controller = controller_of(robot, now_s=lambda: world.now_s, plant=plant)
        self.network = TcpNetwork(world, self._accept)
        self.mute = False
        self.garbled = 0.0
        self._faults = Faults()
        self._publisher = Publisher(self.controller, self._faults)
        self._rng = world.rng("controller")
        self._goals: Mapping[int, float] = self.positions()
        world.after(TICK_S, self._tick)

    def actions(self) -> SlowActions:
        return SlowActions(self.world.rng("actions"))

    def told(self, key: str, value: float) -> tuple[int, float]:
        return self._motors[key], unpack_floats(floats([value]), 1)[0]

    def marks(self, key: str) -> bool:
        return key == "joint7"

    def held_between(self, motor: int, frame: Frame) -> tuple[float, float]:
        """Return the range between the position and the last target, because a hold may repeat that
        target."""
        aims = (frame.positions[motor], frame.before[motor])
        return min(aims) - TOLERATED_RAD, max(aims) + TOLERATED_RAD

    def seams(self) -> tuple[Seam, ...]:
        dial = self.network.open
        return (
            (XArm, "open_wire", lambda driver, clock: XArmWire(driver.config, clock, dial)),
            (XArm, "stop_channel", lambda driver, fds, clock: StopChannel(driver.config, fds, clock, dial)),
        )

    def effect(self, event: Event) -> Effect | None:
        match event.kind:
            case "mute":
                return put(self, "mute", True, False)
            case "garble":
                return put(self, "garbled", GARBLED, 0.0)
            case "brown out":
                return self.brown_out, nothing
        return self.network.effect(event)

    def mend(self) -> None:
        self.network.mend_all()
        self.garbled = 0.0
        self.mute = False

    def brown_out(self) -> None:
        self.controller.wake_up()
        self.network.reset()
        self._log_energised()

    def positions(self) -> Mapping[int, float]:
        return dict(enumerate(self.controller.plant.position_rad, 1))

    @property
    def following(self) -> frozenset[int]:
        controller = self.controller
        if not controller.runs:
            return frozenset()
        return frozenset(motor for motor in self._motors.values() if controller.enabled >> (motor - 1) & 1)

    # -- the controller's end

    def _tick(self) -> None:
        if not self.network.stalled:
            self.controller.tick()
            self._publisher.push(self.world.now_s)
        self.world.after(TICK_S, self._tick)

    def _accept(self, stream: SimStream) -> _Client | _Listener:
        if stream.port == CONTROL_PORT:
            return _Client(self, stream)
        return _Listener(self._publisher, stream)

    def spoil(self, data: bytes) -> bytes:
        """Return a reply, garbled if this fault is on."""
        if self.garbled and self._rng.random() < self.garbled:
            at = self._rng.randrange(len(data))
            data = data[:at] + bytes([data[at] ^ (1 << self._rng.randrange(8))]) + data[at + 1 :]
        return data

    def log(self, exchange: Any, piece: Piece) -> None:
        """Record a request that the controller has just carried out."""
        if exchange.kind not in LOGGED:
            return
        before, was = self._goals, self.energised_log[-1][1]
        told: dict[int, float] = {}
        if exchange.request[HEADER] == SERVO_JOINT:
            told = dict(enumerate(unpack_floats(exchange.request, len(self._motors), HEADER + 1), 1))
        self._goals = {**before, **told}
        if exchange.safe_state == "stop" or exchange.kind == "enable":
            self._goals = self.positions()  # The controller drops earlier targets.
        now, safe_state = self.following, str(exchange.safe_state or "")
        positions = self.positions()
        self.frames.append(
            Frame(
                self.world.now_s,
                piece.left_s,
                piece.role,
                exchange.kind,
                safe_state,
                told,
                before,
                {},
                positions,
                was,
                now,
            )
        )
        self._log_energised()
        news = {motor: round(rad, 4) for motor, rad in told.items() if rad != before[motor]}
        self.world.note("wire", piece.role, f"{exchange.kind} {safe_state} {news} follows {sorted(now)}")

    def _log_energised(self) -> None:
        self.log_energised(self.following)


class _Client:
    """The robot's end of a client of the control port."""

    def __init__(self, arm: SessionArm, stream: SimStream) -> None:
        self._arm = arm
        self._stream = stream
        self._session = ControlSession(arm.controller, Faults())

    def hear(self, piece: Piece) -> None:
        arm = self._arm
        try:
            for exchange in self._session.receive(piece.data, None):
                arm.log(exchange, piece)
                for reply in exchange.replies:
                    if not arm.mute:
                        self._stream.send(arm.spoil(reply.data))
        except ClientGone:
            self._stream.end_by_robot()

    def ended(self) -> None:
        """No-op: a client leaves no state behind."""


class _Listener:
    """The robot's end of a client of a report port."""

    def __init__(self, publisher: Any, stream: SimStream) -> None:
        self._publisher = publisher
        self._entry = publisher.add(stream.port, stream)

    def hear(self, piece: Piece) -> None:
        """No-op: the robot ignores input on a report port."""

    def ended(self) -> None:
        self._publisher.remove(self._entry)

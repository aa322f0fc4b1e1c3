"""The ur5e of the explorer: the twin's controller behind its ports, and ur-rtde's calls in threads.

The arm is energised late. A thread of the SDK sends the control script, which waits in buffers of both
sides and is then compiled. A stop that comes meanwhile finds no program. The watchdog that would end the
script is armed only after the script runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from types import SimpleNamespace
from typing import Any, ClassVar, NamedTuple

import msgspec
import outcome
import trio

from strands_actors.contract.loading import load

from .plan import Event
from .plant import Joints
from .robot_model import Effect, Frame, RobotModel, Seam, nothing
from .session_arm import SlowActions
from .tcp_network import Piece, SimStream, TcpNetwork
from .world import World

TICK_S = 0.004
SAMPLE_TICKS = 2
"""Ticks between two samples: 125 a second."""
THREAD_S = 0.004
"""Longest time from a call of the SDK until its thread carries it out."""
ON_ITS_WAY_S = 0.045
"""Longest time that a sent script waits in buffers before the controller reads it. Measured on the
twin: enabled 1.5 to 42 ms after a safe frame."""
PROGRAM_S = 0.05
"""Time from receiving a program's text to running its first line, as in the twin [assumed]."""
HALT_S = 0.02
REGISTERS = -1
"""The port of the SDK's connection, over which the control script gets its commands."""
OFFSET = 24
SCRIPT = b"def rtde_control():\n  reg_offset_int = # int register offset\n%d\nend\n" % OFFSET

# Loaded by name, as the registry loads drivers.
UR: Any = load("strands_actors.drivers.ur.driver:UR")
URWire: Any = load("strands_actors.drivers.ur.wire:URWire")
StopChannel: Any = load("strands_actors.drivers.ur.stop_channel:URStopChannel")
Controller: Any = load("strands_actors.drivers.ur.twin.controller:Controller")
controller_module: Any = import_module("strands_actors.drivers.ur.twin.controller")
ControlScript: Any = load("strands_actors.drivers.ur.twin.control_script:ControlScript")
Command: Any = load("strands_actors.drivers.ur.twin.commands:Command")
classify_dashboard: Any = load("strands_actors.drivers.ur.twin.commands:classify_dashboard")
classify_script: Any = load("strands_actors.drivers.ur.twin.commands:classify_script")
Dashboard: Any = load("strands_actors.drivers.ur.twin.text_ports:Dashboard")
BANNER: str = load("strands_actors.drivers.ur.twin.text_ports:BANNER")
run_text: Any = load("strands_actors.drivers.ur.twin.script:run_text")
Sample: Any = load("strands_actors.drivers.ur.twin.outputs:Sample")
OUTPUTS: Any = load("strands_actors.drivers.ur.twin.outputs:OUTPUTS")
arm_of: Any = load("strands_actors.drivers.ur.arms:arm_of")
protocol: Any = import_module("strands_actors.drivers.ur.protocol")
plain: Any = import_module("strands_actors.drivers.ur.plain")
sdk: Any = import_module("strands_actors.drivers.ur.sdk")
sdk_calls: Any = import_module("strands_actors.drivers.common.kit.sdk")
MalformedFrame: Any = load("strands_actors.drivers.common.codecs.malformed:MalformedFrame")


class Later(NamedTuple):
    """The result of a call of the SDK, and the time after which the call returns it."""

    after_s: float
    value: object


NEVER = Later(float("inf"), False)


class UploadArm(RobotModel):
    """A ur5e. It counts as energised while its controller runs a control script, and so follows targets."""

    PORT = "192.0.2.5"
    SETTLE_S = 12.0  # a stop takes 1.2 s, and no confirmed one comes 3 s after an upload that was cut off
    KEEPS_TORQUE_BY_RESUME = True
    PROGRAM: ClassVar[type] = ControlScript
    """Type of the program that runs on the controller while the arm is energised."""

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot)
        self.driver_class = UR
        self.driver = driver = self.make_driver(UR)
        self._motors = {axis.key: at for at, axis in enumerate(driver.table, 1)}
        self._all = frozenset(self._motors.values())
        speed = min(axis.speed or 0.0 for axis in driver.table)
        plant = Joints(driver.axes, speed)
        before, controller_module.plant_of = controller_module.plant_of, lambda *_: plant
        try:
            self.controller = Controller(
                arm_of(robot), program_start_s=PROGRAM_S, now_s=lambda: world.now_s, on_event=self._note_of_robot
            )
        finally:
            controller_module.plant_of = before
        self.network = TcpNetwork(world, self._accept)
        self.rng = world.rng("controller")
        self.kept: set[int] = set()  # processes that have opened the SDK
        self.samples: list[SampleClient] = []
        self._goals: Mapping[int, float] = self.positions()
        self._uploaded: Piece | None = None
        self._ticks = 0
        world.after(TICK_S, self._tick)

    def _note_of_robot(self, kind: str, text: str) -> None:
        self.world.note("robot", kind, text)

    def actions(self) -> SlowActions:
        keys = "wrist_3_joint", "shoulder_pan_joint", "elbow_joint"
        return SlowActions(self.world.rng("actions"), *keys)

    def told(self, key: str, value: float) -> tuple[int, float]:
        return self._motors[key], value

    def marks(self, key: str) -> bool:
        return key == "wrist_3_joint"

    def held_between(self, motor: int, frame: Frame) -> tuple[float, float]:
        """Return the position alone, because a stop names no goal."""
        return frame.positions[motor], frame.positions[motor]

    def seams(self) -> tuple[Seam, ...]:
        return (
            (plain, "open_tcp", self.network.open),
            (sdk, "load_sdk", lambda module, install: SimpleNamespace(RTDEControlInterface=_Interface(self))),
            (sdk, "kept", lambda: self.world.current.pid in self.kept),
            (sdk_calls, "call_in_thread", self.call_in_thread),
        )

    def effect(self, event: Event) -> Effect | None:
        if event.kind == "brown out":
            return self.brown_out, nothing
        return self.network.effect(event)

    def mend(self) -> None:
        self.network.mend_all()

    def brown_out(self) -> None:
        """Switch the power off. It stays off until a person switches it on at the pendant."""
        self.controller.reset()
        self.network.reset()
        self._log_energised()

    def positions(self) -> Mapping[int, float]:
        return dict(enumerate(self.controller.plant.position_rad, 1))

    # -- the SDK, in the wire process

    async def call_in_thread(self, function: Callable[..., Any], *args: Any) -> Any:
        """Carry out a call of the SDK some time later, even if its caller no longer waits."""
        world, process = self.world, self.world.current
        process.resources.start_thread()
        done, results = trio.Event(), list[outcome.Outcome[Any]]()

        def finish(result: outcome.Outcome[Any]) -> None:
            results.append(result)
            done.set()

        def act() -> None:
            result = outcome.capture(function, *args)
            if isinstance(result, outcome.Value) and isinstance(result.value, Later):
                later = result.value
                if later.after_s < float("inf"):
                    world.after(later.after_s, lambda: process.post(lambda: finish(outcome.Value(later.value))))
            else:
                finish(result)

        world.after(THREAD_S * self.rng.random(), lambda: process.post(act))
        await done.wait()
        return results[0].unwrap()

    # -- the controller's end

    def _tick(self) -> None:
        if not self.network.stalled:
            self._ticks += 1
            was = self.controller.program
            self.controller.tick()
            if isinstance(self.controller.program, self.PROGRAM) and self.controller.program is not was:
                assert self._uploaded is not None
                self.log("enable", "", self._uploaded)
            self._log_energised()
            if self._ticks % SAMPLE_TICKS == 0:
                sample = Sample(self.controller)
                for client in list(self.samples):
                    client.tell(sample)
        self.world.after(TICK_S, self._tick)

    def _accept(self, stream: SimStream) -> Any:
        match stream.port:
            case protocol.DASHBOARD_PORT:
                return _Dashboard(self, stream)
            case protocol.RTDE_PORT:
                return SampleClient(self, stream)
            case port if port == REGISTERS:
                return _Registers(self)
        return _Script(self)

    def take_script(self, text: bytes, piece: Piece) -> None:
        kind = classify_script(text)
        if kind == "enable":
            self._uploaded = piece
        run_text(text, self.controller)
        if kind == "safe":
            self.log("safe", "stop", piece)

    @property
    def following(self) -> frozenset[int]:
        return self._all if isinstance(self.controller.program, self.PROGRAM) else frozenset()

    def log(self, kind: str, safe_state: str, piece: Piece, goals: Mapping[int, float] | None = None) -> None:
        """Record a request that the controller has just carried out."""
        before, was, positions = self._goals, self.energised_log[-1][1], self.positions()
        self._goals = {**before, **(goals or {})} if kind == "setpoint" else positions
        now_s, now = self.world.now_s, self.following
        frame = Frame(
            now_s, piece.left_s, piece.role, kind, safe_state, goals or {}, before, {}, positions, was, now
        )
        self.frames.append(frame)
        self._log_energised()
        news = {motor: round(rad, 4) for motor, rad in (goals or {}).items() if rad != before[motor]}
        self.world.note("wire", piece.role, f"{kind} {safe_state} {news} follows {sorted(now)}")

    def _log_energised(self) -> None:
        self.log_energised(self.following)


class _Interface:
    """Replaces the SDK's class ``RTDEControlInterface``. A call connects and returns an interface."""

    FLAG_UPPER_RANGE_REGISTERS = FLAG_NO_WAIT = 0

    def __init__(self, arm: UploadArm) -> None:
        self._arm = arm

    def __call__(self, host: str, hz: float, flags: int) -> SimSdk | Later:
        """Connect. Raise ``RuntimeError`` if the controller cannot be reached. With a frozen controller the
        call never returns."""
        arm, process = self._arm, self._arm.world.current
        process.resources.open_file()
        arm.kept.add(process.pid)
        if arm.network.unreachable:
            raise RuntimeError("Timeout connecting to UR dashboard server.")
        return NEVER if arm.network.stalled else SimSdk(arm)


class SimSdk:
    """Send commands, and wait for the control script as the SDK does."""

    def __init__(self, arm: UploadArm) -> None:
        self._arm = arm
        self._stream = arm.network.connect("registers", REGISTERS)
        self._script: SimStream | None = None

    def reuploadScript(self) -> bool:  # the SDK's names
        arm = self._arm
        if arm.network.unreachable:
            raise RuntimeError("script client is not connected")
        self._script = arm.network.connect("script", protocol.SECONDARY_PORT)
        self._script.write(SCRIPT, ON_ITS_WAY_S * arm.rng.random())
        return True

    def isProgramRunning(self) -> bool:
        return bool(self._arm.following)

    def setWatchdog(self, min_hz: float) -> Any:
        return self._wait_for(Command.SET_WATCHDOG, [min_hz])

    def kickWatchdog(self) -> bool:
        return self._send(Command.KICK_WATCHDOG)

    def servoJ(self, q: Sequence[float], *others: float) -> bool:
        return self._send(Command.SERVO_J, q)

    def servoStop(self, deceleration: float) -> Any:
        return self._wait_for(Command.SERVO_STOP)

    def stopScript(self) -> Any:
        return self._wait_for(Command.STOP_SCRIPT)

    def _send(self, command: int, values: Sequence[float] = ()) -> bool:
        self._stream.write(msgspec.msgpack.encode((int(command), list(values))))
        return bool(self._arm.following)

    def _wait_for(self, command: int, values: Sequence[float] = ()) -> Any:
        ran = self._send(command, values)
        network = self._arm.network
        return NEVER if network.unreachable or network.stalled else Later(HALT_S * self._arm.rng.random(), ran)


class _Dashboard:
    def __init__(self, arm: UploadArm, stream: SimStream) -> None:
        self._arm = arm
        self._stream = stream
        self._dashboard = Dashboard(arm.controller, arm.robot)
        self._pending = b""
        stream.send(f"{BANNER}\n".encode())

    def hear(self, piece: Piece) -> None:
        *lines, self._pending = (self._pending + piece.data).split(b"\n")
        for line in lines:
            text = line.decode("utf-8", "replace").strip()
            answer = self._dashboard.answer(text)
            if classify_dashboard(text) == "safe":
                self._arm.log("safe", "stop", piece)
            self._stream.send(f"{answer}\n".encode())

    def ended(self) -> None:
        """No-op: a client leaves no state behind."""


class _Script:
    """The robot's end of a client of a script port. It takes programs, and sends no state."""

    def __init__(self, arm: UploadArm) -> None:
        self._arm = arm

    def hear(self, piece: Piece) -> None:
        self._arm.take_script(piece.data, piece)

    def ended(self) -> None:
        """No-op: a client leaves no state behind."""


class _Registers:
    """The robot's end of the SDK's connection, with commands for the control script."""

    KINDS: Mapping[int, tuple[str, str]] = {
        Command.SERVO_J: ("setpoint", ""),
        Command.SERVO_STOP: ("safe", "hold"),
        Command.STOP_SCRIPT: ("safe", "stop"),
    }

    def __init__(self, arm: UploadArm) -> None:
        self._arm = arm

    def hear(self, piece: Piece) -> None:
        command, values = msgspec.msgpack.decode(piece.data)
        arm, controller = self._arm, self._arm.controller
        ran = bool(arm.following)
        doubles = {f"input_double_register_{OFFSET + at}": value for at, value in enumerate(values)}
        controller.write({**doubles, f"input_int_register_{OFFSET}": command})
        if command not in (Command.SERVO_J, Command.KICK_WATCHDOG):
            controller.write({f"input_int_register_{OFFSET}": int(Command.NONE)})
        if ran and command in self.KINDS:
            arm.log(*self.KINDS[command], piece, dict(enumerate(values, 1)))

    def ended(self) -> None:
        """No-op: a client leaves no state behind."""


class SampleClient:
    """The robot's end of an RTDE client that only reads."""

    def __init__(self, arm: UploadArm, stream: SimStream) -> None:
        self._arm = arm
        self._stream = stream
        self._decoder = protocol.Decoder()
        self._recipe: Any = None
        self._started = False

    def hear(self, piece: Piece) -> None:
        try:
            packets = list(self._decoder.feed(piece.data))
        except MalformedFrame:
            self._stream.end_by_robot()
            return
        for packet in packets:
            answer = self._answer(packet)
            if answer is not None:
                self._stream.send(protocol.frame(packet.kind, answer))
            self._take(packet, piece)

    def _take(self, packet: Any, piece: Piece) -> None:
        """Carry out a packet, in addition to the answer. A client that only reads needs nothing."""

    def _answer(self, packet: Any) -> bytes | None:
        if packet.kind == protocol.Kind.OUTPUTS:
            names = packet.payload[8:].decode().split(",")
            types = [OUTPUTS[name][0] for name in names]
            self._recipe = protocol.Recipe(1, names, types)
            return b"\x01" + ",".join(types).encode()
        if packet.kind == protocol.Kind.START:
            self._started = True
            self._arm.samples.append(self)
        return b"\x01"

    def tell(self, sample: Any) -> None:
        values = {name: sample[name] for name in self._recipe.names}
        self._stream.send(self._recipe.pack(values))

    def ended(self) -> None:
        if self in self._arm.samples:
            self._arm.samples.remove(self)

"""Simulate a Gen3 (a "twin"): a Kortex server on TCP and UDP, its base, its arm and its gripper.

A test controls a simulated robot by lines of text. This one accepts the lines of every twin, and also ``state
NAME`` and ``mode NAME``, with the names of ``protocol.ArmState`` and ``protocol.ServoingMode``. ``object PERCENT``
puts something between the fingers, which meet it when they are so far open. ``object none`` takes it away.
``gripper lost|found`` takes the gripper from the interface. Its log of all frames (wire log) shows no passwords.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any

import msgspec
import trio

from strands_actors.contract.loading import load
from strands_actors.contract.options import option
from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.body import TIMESTEP_S
from strands_actors.drivers.common.physics.controlled_body import ControlledBody
from strands_actors.drivers.common.physics.fingers import PhysicalFingers
from strands_actors.drivers.common.physics.handed_body import HandedBody
from strands_actors.drivers.common.physics.model_rows import build as build_model
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.twin import (
    ClientGone,
    Exchange,
    Fault,
    NetworkOptions,
    Port,
    Reply,
    TcpServer,
    TwinRobot,
    WireLog,
    main_of,
)
from strands_actors.drivers.common.twin.server import Conversation
from strands_actors.drivers.common.twin.tcp import Connection
from strands_actors.drivers.kinova import protocol as p
from strands_actors.drivers.kinova.robots import MOUNTED, TABLES, model_table

from .base import Base
from .datagrams import Datagrams
from .functions import ACTIONS, CALLS, Function
from .sessions import Second

MODELLED = (CALLS, ACTIONS)


class OnInterface(enum.StrEnum):
    NONE = "none"
    ROBOTIQ_2F_85 = "robotiq_2f_85"  # without physics
    MOUNTED = "robotiq_2f85"  # in the physics of the arm


class KinovaTwinOptions(NetworkOptions, frozen=True):
    port: Port = p.TCP_PORT
    username: Annotated[str, option("of those who may open a session")] = "admin"
    password: Annotated[str, option("theirs")] = "admin"
    second: Annotated[Second, option(f"what becomes of a second session: {', '.join(Second)}")] = Second.ACCEPTED
    gripper: Annotated[
        OnInterface,
        option(
            f"gripper on the interface: {', '.join(OnInterface)}; only the last one is in the physics of the arm"
        ),
    ] = OnInterface.ROBOTIQ_2F_85


class KinovaBody(ControlledBody):
    def __init__(self, base: Base) -> None:
        super().__init__(base.plant, base.advance)
        self._base = base

    @property
    def driven(self) -> bool:
        return self._base.driven

    @property
    def simulation_moves(self) -> bool:
        return self._base.simulation_moves

    def let_simulation_move(self, on: bool) -> None:
        self._base.simulation_moves = True
        self.hold()
        self._base.simulation_moves = on

    def set_controller_targets(self, values: Sequence[float]) -> None:
        self._base.set_targets(list(values))

    def step(self, steps: int) -> None:
        if self._base.gripper is not None:
            self._base.gripper.pass_time(steps * TIMESTEP_S)
        super().step(steps)

    def reset(self) -> None:
        super().reset()
        self._base.wake_up()


class KinovaTwin(TwinRobot):
    """The simulated robot: one base with its arm, which all clients share. A restart closes every session."""

    TICK_S = 0.01
    RESTART_CUTS = True

    def __init__(self, base: Base, *, mounted: bool = False) -> None:
        """Args:
        base: The base.
        mounted: True if the gripper is in the physics of the arm, and so one more axis for a simulation.
        """
        super().__init__()
        self.base = base
        arm = KinovaBody(base)
        self.body = HandedBody(arm, base.gripper.motion) if mounted and base.gripper is not None else arm

    def begin_fault(self, fault: Fault) -> None:
        self.base.advance()
        self.base.set_fault(fault)

    def power_cycle(self) -> None:
        self.base.wake_up()

    def tick(self) -> None:
        self.base.advance()

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["state", name] if name in p.ArmState.__members__:
                self.base.set_state(p.ArmState[name])
            case ["mode", name] if name in p.ServoingMode.__members__:
                self.base.set_mode(p.ServoingMode[name])
            case ["object", place] if self.base.gripper and (place == "none" or place.isdecimal()):
                self.base.gripper.motion.object_at = None if place == "none" else 1.0 - int(place) / 100
            case ["gripper", "lost" | "found" as word] if self.base.gripper:
                self.base.gripper.lost = word == "lost"
            case _:
                return False
        return True


class KortexSession:
    """One client's connection, as the simulated base handles it."""

    def __init__(self, twin: KinovaTwin, send: Callable[[p.Frame], None] | None = None) -> None:
        """Args:
        twin: The simulated robot.
        send: Sends a notification to the client. None: the client gets none.
        """
        self._twin = twin
        self._send = send
        self._decoder = p.Decoder()

    def receive(self, data: bytes, bits_per_s: int | None) -> Iterator[Exchange]:
        for frame in self._decoder.feed(data):
            yield self.exchange(frame, p.Frame.encode)
        if self._decoder.skipped:
            raise ClientGone  # A real base also closes the connection after unreadable bytes [assumed].

    def exchange(self, frame: p.Frame, encode: Callable[[p.Frame], bytes]) -> Exchange:
        """Carry out a request.

        Args:
            frame: The request.
            encode: Encodes a frame for the client's transport.
        """
        kind = self._twin.base.kind(frame)
        replies: list[Reply] = []
        if frame.kind == p.Kind.REQUEST and self._twin.faults.of(None) is not Fault.OFF:
            answer = Reply(0.0, encode(self._twin.base.answer(self, frame)), None, kind)
            reply = self._twin.faults.apply(answer)
            replies = [] if reply is None else [reply]
        return Exchange(kind, encode(without_password(frame)), replies)

    def notify(self, frame: p.Frame) -> None:
        """Send a notification. A client that does not read loses some."""
        silent = self._twin.faults.of(None) in (Fault.OFF, Fault.HALF_OPEN)
        if self._send is not None and not silent:
            self._send(frame)


def without_password(frame: p.Frame) -> p.Frame:
    """Return a request without the password in it, for the log."""
    if frame.call not in (p.Call.CREATE_SESSION, Function.CREATE_USER_PROFILE):
        return frame
    try:
        if frame.call == p.Call.CREATE_SESSION:
            payload = msgspec.structs.replace(p.Login.decode(frame.payload), password="***").encode()
        else:
            payload = pb.bytes_field(1, pb.last_bytes(pb.message(frame.payload), 1)) + pb.bytes_field(2, b"***")
    except MalformedFrame:
        payload = b""
    return msgspec.structs.replace(frame, payload=payload)


class KinovaServer(TcpServer):
    """Serve the clients of one simulated robot, and let its arm move between their requests, too."""

    def __init__(self, twin: KinovaTwin, port: int, log: WireLog, host: str | None) -> None:
        self._twin = twin
        self._datagrams = Datagrams(lambda send: KortexSession(twin, send), log)
        super().__init__(twin, {port: self._attend_client}, log, host)

    def plug(self) -> None:
        super().plug()
        host, _, port = self.address.rpartition(":")
        self._datagrams.plug(host, int(port))

    def unplug(self) -> None:
        super().unplug()
        self._datagrams.unplug()

    def start(self, nursery: trio.Nursery) -> None:
        super().start(nursery)
        nursery.start_soon(self._datagrams.serve, self._frost)

    async def _attend_client(self, connection: Connection) -> None:
        session = KortexSession(self._twin, lambda frame: connection.send_logged("notification", frame.encode()))
        await Conversation(session, connection, connection.log, connection.frost).serve()


def twin_of(robot: str, **options: Any) -> KinovaTwin:
    """Return a simulated robot of ``robots.toml``. ``options`` are the keyword arguments of ``Base``."""
    return KinovaTwin(Base(TABLES.table(robot), **options))


def twin_with_gripper(robot: str, gripper: str, **options: Any) -> KinovaTwin:
    """Return a simulated robot with a gripper in the physics of its arm."""
    table = model_table(robot, gripper)
    spec = build_model(table)
    load(f"{MOUNTED}:motorise")(spec)
    plant = Plant(spec, [joint["key"] for joint in table["joints"]], float(table["bandwidth"]), table["home_rad"])
    fingers = PhysicalFingers(plant, load(f"{MOUNTED}:JOINTS"))
    return KinovaTwin(Base(TABLES.table(robot), plant=plant, fingers=fingers, **options), mounted=True)


def build(robot: str, options: KinovaTwinOptions, log: WireLog) -> KinovaServer:
    """Return the server of a robot of ``robots.toml``."""
    base = {"username": options.username, "password": options.password, "second": options.second}
    if options.gripper is OnInterface.MOUNTED:
        twin = twin_with_gripper(robot, options.gripper, **base)
    else:
        twin = twin_of(robot, has_gripper=options.gripper is OnInterface.ROBOTIQ_2F_85, **base)
    return KinovaServer(twin, options.port, log, options.host)


main = main_of(KinovaTwinOptions, build)

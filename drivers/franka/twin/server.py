"""Serve the FCI of a simulated Franka controller: requests on TCP, and a state each millisecond on UDP.

A real controller never waits for its client. The simulated controller runs on the same computer as its client, so
during a motion it may give the client more time for a command (``pace``). Without a motion it wakes up every few
milliseconds, and sends the states that are due together.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import sys
import time
from collections import deque
from collections.abc import Sequence

import trio

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.handed_body import HandedBody
from strands_actors.drivers.common.twin import (
    ClientGone,
    Connection,
    Fault,
    Handler,
    Reply,
    TcpServer,
    TwinRobot,
    WireLog,
)
from strands_actors.drivers.franka import hand_protocol
from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka.arms import JOINTS, arm_of
from strands_actors.drivers.franka.grippers import WIDTH_M

from .body import FrankaBody
from .controller import TICK_S, Controller
from .description import urdf
from .hand import Hand
from .hand_service import HandService
from .model_library import X86_64_LINUX, model_library
from .pace import Pace, Processors, Stretches
from .requests import NOT_POSSIBLE, REQUESTS, SETTINGS

IDLE_TICKS = 4
"""Milliseconds between two wake-ups without a motion."""
ALONE_S = 0.02
"""Time in seconds between two wake-ups while no client is connected."""
LONGEST_TICKS = 20
"""Most milliseconds to catch up after a pause of this process. The rest is dropped."""
LOGGED_BYTES = 64
"""Bytes of a command to log: its number and q. The log grows by this much per millisecond."""

MUCH = 0.05
"""Share of stretched milliseconds of a motion at which the user is warned."""

LIMIT_SIZE = 1 + 24 + 128 + 1
"""Bytes of the reply to a request for a Cartesian limit."""

KINDS = {"move": "enable", "stop": "safe", "recover": "enable"}


class FrankaTwin(TwinRobot):
    """The faults and restarts of one simulated controller. A joint has a number from 1 to 7. After a restart the
    controller is ready for a motion."""

    PARTS = range(1, JOINTS + 1)
    RESTART_CUTS = True

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self.controller = controller
        arm = FrankaBody(controller)
        self.body = arm if controller.hand is None else HandedBody(arm, controller.hand.motion)

    def begin_fault(self, fault: Fault) -> None:
        self.controller.fault = fault

    def jam(self, index: int, on: bool) -> None:
        self.controller.plant.set_stuck(index, on)

    def power_cycle(self) -> None:
        self.controller.reset()


class FrankaServer(TcpServer):
    """Serve the clients of one simulated controller, and call its tick every millisecond."""

    def __init__(
        self,
        robot: str,
        fci: int,
        log: WireLog,
        host: str | None,
        tick_wait_s: float,
        stretches: Stretches = "busy",
        states_from: str | None = None,
        gripper: str = "",
    ) -> None:
        """Reserve the ports.

        Args:
            robot: The name of the arm.
            fci: The version of the interface.
            log: The log of the messages.
            host: The address to serve at. None: one of its own.
            tick_wait_s: Longest stretch of a millisecond.
            stretches: When a millisecond may be stretched.
            states_from: The address that states come from. None: the same as ``host``.
            gripper: The hand on its flange; empty for none.
        """

        def on_event(kind: str) -> None:
            log.write(time.monotonic_ns(), "robot", [(kind, b"")])

        arm = arm_of(robot)
        self.controller = Controller(arm, fci, on_event, gripper)
        self._model = urdf(arm).encode() if fci == 10 else b""
        self._twin = FrankaTwin(self.controller)
        self._name = robot
        self._pace = Pace(tick_wait_s, stretches, Processors())
        self._has_warned = False  # True after the warning that time is stretched.
        self._listeners_of_state: dict[Connection, tuple[str, int]] = {}
        self._mover: Connection | None = None
        self._late: deque[tuple[float, bytes]] = deque()
        handlers: dict[int, Handler] = {p.PORT: self._attend_client}
        hand = self.controller.hand
        self._hand = None if hand is None else HandService(hand, self._send_state)
        if self._hand is not None:
            handlers[hand_protocol.PORT] = self._hand.attend
        super().__init__(self._twin, handlers, log, host)
        self._udp = socket.socket(type=socket.SOCK_DGRAM)
        self._udp.setblocking(False)
        self._udp.bind((states_from or self.host, 0))

    @property
    def _dialect(self) -> p.Dialect:
        return self.controller.dialect

    # -- faults and events that a test sets

    def set_fault(self, text: str) -> None:
        super().set_fault(text)
        self._late.clear()

    def order(self, words: Sequence[str]) -> bool:
        match words:
            case ["reflex", name] if name in p.ERRORS:
                self._end(self.controller.reflex(name))
            case ["mode", name] if name in p.RobotMode.__members__:
                self._end(self.controller.set_mode(p.RobotMode[name]))
            case ["success-rate", "measured"]:
                self.controller.success_rate = None
            case ["success-rate", number]:
                self.controller.success_rate = float(number)
            case ["gripper", word] if self.controller.hand is not None:
                return self._order_hand(self.controller.hand, word)
            case ["object", place] if self.controller.hand is not None and (place == "none" or place.isdecimal()):
                self.controller.hand.motion.object_at = None if place == "none" else 1.0 - int(place) / 100
            case _:
                return False
        return True

    def _order_hand(self, hand: Hand, word: str) -> bool:
        match word:
            case "lost" | "found":
                hand.is_lost = word == "lost"
            case "unhomed" | "homed":
                hand.most_m = 0.0 if word == "unhomed" else WIDTH_M
            case _:
                return False
        return True

    def _send_state(self, state: bytes, address: tuple[str, int]) -> None:
        self._udp.sendto(state, address)

    def close(self) -> None:
        super().close()
        self._udp.close()

    # -- requests of clients on TCP

    async def _attend_client(self, connection: Connection) -> None:
        decoder = p.Decoder(p.LARGEST_REQUEST)
        try:
            while True:
                t_ns, data = await connection.receive()
                self._take_commands()  # First handle the commands that the client sent before this request.
                for message in decoder.feed(data):
                    name = self._dialect.name_of(message.code)
                    connection.log_received(
                        t_ns, KINDS.get(name, "config" if name != "?" else "other"), message.raw
                    )
                    self._obey(connection, name, message)
        except MalformedFrame:
            raise ClientGone from None  # A real controller also closes the connection after an unreadable request.
        finally:
            self._listeners_of_state.pop(connection, None)
            if self._mover is connection:
                self._mover = None
                if self.controller.stop("aborted") is not None:
                    self._log.write(time.monotonic_ns(), "robot", [("aborted", b"")])

    def _obey(self, connection: Connection, name: str, message: p.Message) -> None:
        controller, dialect = self.controller, self._dialect
        answer = b"\0"
        if name == "?":
            raise MalformedFrame(f"there is no command {message.code}")
        match name:
            case _ if name not in REQUESTS:
                answer = NOT_POSSIBLE.ljust(LIMIT_SIZE if name == "cartesian_limit" else 1, b"\0")
            case _ if name in SETTINGS:
                answer = controller.store(name, message.payload)
            case "connect":
                version, port = p.connect_request(message.payload)
                matches = version == dialect.version
                answer = bytes((not matches, dialect.version, 0))
                if matches:
                    self._listeners_of_state[connection] = connection.peer_host, port
            case "move":
                status = self._begin_motion(connection, message)
                answer = bytes((dialect.move_statuses.index(status),))
                if status == "motion_started":
                    self._mover = connection
            case "stop":
                self._end(controller.stop("preempted"))
            case "recover":
                answer = b"\0" if controller.recover() else b"\1"
            case "model" if dialect.version == 10:
                answer = b"\0" + self._model
            case "model":
                answer = b"\0" + model_library() if message.payload == X86_64_LINUX else b"\1"
        connection.send_logged("read", p.Message(message.code, message.id, answer).raw)

    def _begin_motion(self, connection: Connection, message: p.Message) -> str:
        """Begin the motion that a request asks for, if that is possible. Return the status for the reply."""
        layout = self._dialect.move
        if len(message.payload) != layout.size or connection not in self._listeners_of_state:
            return "invalid_argument"
        controller, generator, *rest = layout.unpack(message.payload)
        if not all(0.0 < deviation < math.inf for deviation in rest[:6]):
            return "invalid_argument"
        if any(rest[6:7]):
            return "not_possible"  # An asynchronous motion of FCI 10 [assumed: this byte requests it].
        return self.controller.start(message.id, controller, generator)

    def _end(self, ended: tuple[int, str] | None) -> None:
        """Send the second reply to the ``move`` request: the status with which the motion has ended."""
        if ended is None:
            return
        mover, self._mover = self._mover, None
        if mover is not None:
            status = self._dialect.move_statuses.index(ended[1])
            mover.send_logged(
                "read", p.Message(self._dialect.commands.index("move"), ended[0], bytes((status,))).raw
            )

    # -- states and commands on UDP, and the ticks of the controller

    def start(self, nursery: trio.Nursery) -> None:
        super().start(nursery)
        nursery.start_soon(self._pass_time)

    async def _pass_time(self) -> None:
        due_s = time.monotonic()
        while True:
            await self._frost.thawed()
            now_s = time.monotonic()
            if self.controller.motion is not None:
                due_s = await self._tick_with_client(due_s if self._pace.ticks else now_s)
                continue
            self._report_pace()
            ticks = int((now_s - due_s) / TICK_S)
            due_s += ticks * TICK_S
            for _ in range(min(ticks, LONGEST_TICKS)):
                self._tick()
            await trio.sleep(IDLE_TICKS * TICK_S if self._listeners_of_state else ALONE_S)
            self._take_commands()

    async def _tick_with_client(self, due_s: float) -> float:
        """Run one millisecond of a motion: send a state, wait for its command, and wait for the end of the
        millisecond. This blocks the process, which costs half as much as two turns of the event loop.

        Args:
            due_s: When this millisecond was due.

        Returns:
            When the next one is due.
        """
        pace = self._pace
        pace.begin(due_s)
        self._tick()
        while self.controller.motion is not None:
            now_s = time.monotonic()
            over = pace.is_over(now_s)
            # Read commands before ending the wait: a command that arrived during a pause of this process is in
            # time.
            if self._take_commands() or over:
                break
            select.select([self._udp], [], [], pace.wait_s(now_s))
            await trio.lowlevel.checkpoint()
        rest_s = pace.rest_s(time.monotonic())
        if rest_s > 0:
            time.sleep(rest_s)  # noqa: ASYNC251
        await trio.lowlevel.checkpoint()
        return pace.end(time.monotonic())

    def _report_pace(self) -> None:
        """After a motion, log how many of its milliseconds were stretched. Tell the user once if they were many."""
        pace = self._pace
        if pace.stretched:
            text = f"{pace.stretched} of {pace.ticks} ms"
            self._log.write(time.monotonic_ns(), "robot", [("stretched", text.encode())])
            if not self._has_warned and pace.stretched > MUCH * pace.ticks:
                self._has_warned = True
                print(
                    f"{self._name}: the simulated controller has stretched {text} of a motion, because this "
                    "computer is busy. Close other programs for real time",
                    file=sys.stderr,
                    flush=True,
                )
        pace.start_motion()

    def _tick(self) -> None:
        self._end(self.controller.tick())
        if self._hand is not None:
            self._hand.report()
        if not self._listeners_of_state:
            return
        reply = self._twin.faults.apply(Reply(0.0, self.controller.state()))
        now_s = time.monotonic()
        if reply is not None:
            self._late.append((now_s + reply.delay_s + reply.late_s, reply.data))
        while self._late and self._late[0][0] <= now_s:
            _, data = self._late.popleft()
            for address in self._listeners_of_state.values():
                # Ignore a client with a full buffer. If the client has gone, its TCP connection shows that.
                with contextlib.suppress(OSError):
                    self._udp.sendto(data, address)

    def _take_commands(self) -> bool:
        """Handle the received commands. Return whether one of them was in time for the running motion."""
        in_time = False
        while True:
            try:
                data = self._udp.recv(p.LARGEST_REQUEST)
            except BlockingIOError:
                return in_time
            except OSError:
                return in_time  # The system reports that an earlier state was sent to a closed port.
            try:
                command = self._dialect.command(data)
            except MalformedFrame:
                of_motion = late = False
            else:
                late = command.message_id < self.controller.message_id  # It answers an earlier state.
                of_motion = self.controller.motion is not None if late else self.controller.take(command)
            # Without a motion a command has no effect: the controller ignores it.
            kind = "setpoint" if of_motion else "other"
            self._log.write(time.monotonic_ns(), "host", [(kind, data[:LOGGED_BYTES])])
            in_time = in_time or (of_motion and not late)

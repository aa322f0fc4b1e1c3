"""Talk to a T1 by one DDS participant: send commands and requests, receive states and answers.

The process that drives the robot (wire) and the supervising process (root) each create a participant. Nothing here
waits or loops:
``poll`` processes the received messages, ``send_*`` and ``ask`` send at once.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.motor_targets import ROWS
from strands_actors.drivers.common.ports.exchange import Exchange
from strands_actors.drivers.common.ports.network_interfaces import address_of
from strands_actors.drivers.common.rtps import CDR, Participant, Reader, Writer, own_address
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from . import rpc
from .config import CONTROL_S, BoosterConfig
from .protocol import IDLE, Command, Motor, State
from .robots import LAST_ARM

FIND_S = 4.0
"""Time for both sides to discover each other, and for the first state."""

AGAIN_S = 0.2
"""Pause before a request without a good answer is sent again."""

MAX_PENDING = 32

T = TypeVar("T")
ResponseHandler = Callable[[rpc.Response], None]


class Calls:
    """Send requests to the robot's service and match the answers to them."""

    def __init__(self, participant: Participant, robot_name: str, clock: Clock) -> None:
        self.last_answer_ns = 0
        """Time of the newest answer, to any request."""
        self._clock = clock
        self._exchange: Exchange[str, ResponseHandler, rpc.Response] = Exchange(MAX_PENDING)
        self._writer = participant.writer(rpc.request_topic(robot_name), rpc.REQUEST_TYPE, reliable=True)
        self._reader = participant.reader(
            rpc.response_topic(robot_name), rpc.RESPONSE_TYPE, self._on_response, reliable=True
        )

    @property
    def ends(self) -> tuple[Writer, Reader]:
        return self._writer, self._reader

    @property
    def matched(self) -> bool:
        """Return True if the robot reads our requests and its answers can reach us. Otherwise an
        answer would be lost."""
        return self._writer.matched > 0 and self._reader.matched > 0

    def ask(self, api: rpc.Api, body: str, on_response: ResponseHandler, stop: bool = False) -> bool:
        """Send a request.

        Args:
            api: The function of the service.
            body: Its arguments in JSON.
            on_response: Called from ``poll`` with the answer, at most once.
            stop: Send the request also to a robot that has announced its departure from DDS.

        Returns:
            True if it was sent and the robot can also answer. After False the request may still arrive.
        """
        number = str(uuid.uuid4())
        self._exchange.sent(number, on_response)
        request = CDR + rpc.encode_request(rpc.Request(number, api, body))
        if stop:
            return self._writer.write_stop(request) > 0 and (self.matched or self._writer.has_parted)
        return self._writer.write(request) > 0 and self.matched

    def _on_response(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        # An answer that cannot be decoded counts as missing.
        with suppress(MalformedFrame):
            response = rpc.decode_response(payload[4:])
            sent = self._exchange.take(response.id, response)
            if sent is not None:
                self.last_answer_ns = self._clock.now_ns()
                sent.request(response)


class Order:
    """One request that a stop needs. It is repeated until the robot answers with success. Call
    ``step`` often."""

    def __init__(self, calls: Calls, api: rpc.Api, body: str = "") -> None:
        self.written = False
        self.answer: rpc.Response | None = None
        """The newest answer."""
        self.tries = 0
        self._is_sent = False
        self._calls = calls
        self._api = api
        self._body = body
        self._requested_ns = 0

    @property
    def done(self) -> bool:
        return self.answer is not None and self.answer.status == rpc.OK

    @property
    def error(self) -> str:
        """Return why the request is not done: no answer, or an error in the answer."""
        return "not answered" if self.answer is None else self.answer.error

    def step(self, now_ns: int) -> None:
        # Try again sooner if the request could not be sent, because DDS has not connected the robot yet.
        pause_s = AGAIN_S if self._is_sent else CONTROL_S
        if self.done or now_ns - self._requested_ns < pause_s * NS:
            return
        self._requested_ns = now_ns
        self._is_sent = self._calls.ask(self._api, self._body, self._hear, stop=True)
        self.written |= self._is_sent
        self.tries += self._is_sent

    def _hear(self, answer: rpc.Response) -> None:
        if not self.done:
            self.answer = answer


class Link:
    """The DDS connection to one robot: its participant, writers and readers, and the newest state.

    Raises:
        WireDown: The sockets cannot be opened.
    """

    def __init__(self, config: BoosterConfig, clock: Clock) -> None:
        robot = config.host
        try:
            own = address_of(config.interface) if config.interface else own_address(robot.partition(":")[0])
            multicast = not own.startswith("127.")
            self.participant = Participant(config.domain, own, (robot,), multicast, clock=clock, only=robot)
        except ValueError as error:
            raise WireDown(f"{robot}: {error}") from None
        self.clock = clock
        self.model = config.model
        self.name = config.name
        self.malformed = 0
        self.calls = Calls(self.participant, config.name, clock)
        # A reliable writer serves reliable and best-effort readers. Its history has one sample, so a lost command
        # is never followed by an older one.
        self.commands = self.participant.writer(
            p.topic("joint_ctrl", config.name), p.COMMAND_TYPE, reliable=True, depth=1
        )
        self._command_type = config.command_type
        self._state: State | None = None
        self._state_ns = 0
        # The payload of the newest state and its arrival time; None once it is decoded.
        self._pending: tuple[bytes, int] | None = None
        self._listens = False

    @property
    def matched(self) -> bool:
        """Return True if the robot receives our commands, and its answers can reach us."""
        return self.commands.matched > 0 and self.calls.matched

    def listen(self) -> None:
        """Subscribe to the robot's state."""
        if not self._listens:
            self._listens = True
            self.participant.reader(p.topic("low_state", self.name), p.STATE_TYPE, self._on_state)

    def follow(
        self, name: str, type_name: str, decode: Callable[[memoryview], T], take: Callable[[T, int], None]
    ) -> None:
        """Subscribe to another topic of the robot. ``take`` is called with each decoded sample and
        its time."""

        def on_sample(payload: memoryview, writer: bytes, t_ns: int) -> None:
            try:
                sample = decode(payload[4:])
            except MalformedFrame:
                self.malformed += 1
            else:
                take(sample, t_ns)

        self.participant.reader(p.topic(name, self.name), type_name, on_sample)

    def poll(self) -> None:
        self.participant.poll()

    def close(self) -> None:
        self.participant.close()

    # -- states

    @property
    def state(self) -> State | None:
        """Return the newest readable state. It is decoded only when it is asked for, because about
        five states arrive for each one that is used."""
        self._look()
        return self._state

    @property
    def state_ns(self) -> int:
        """Return the arrival time of ``state``; 0 if no state has arrived."""
        self._look()
        return self._state_ns

    def _look(self) -> None:
        """Decode the newest payload, if it is readable. An unreadable payload does not renew the
        time of the state. Otherwise the old state would look new as long as unreadable payloads
        arrive."""
        pending, self._pending = self._pending, None
        if pending is None:
            return
        payload, t_ns = pending
        try:
            self._state = p.decode_state(payload[4:], self._command_type)
        except MalformedFrame:
            self.malformed += 1
        else:
            self._state_ns = t_ns

    def of_arms(self, row: Sequence[float]) -> tuple[float, ...]:
        """Pick the values of the arm joints from a row of all motors; NaN for a motor that the
        robot does not report."""
        return tuple(row[joint.slot] if joint.slot < len(row) else math.nan for joint in self.model.joints)

    def _on_state(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        self._pending = bytes(payload), t_ns

    # -- commands

    def send_target(self, values: Sequence[float]) -> bool:
        """Send a target to the arm joints: rows of q, dq, tau, kp and kd, one after the other. All
        other motors get ``IDLE``. Return True if it was sent."""
        count = len(self.model.joints)
        rows = [values[count * row : count * (row + 1)] for row in range(len(ROWS))]
        joints = zip(self.model.joints, *rows, strict=True)
        command = self._command([Motor(joint.mode, *row) for joint, *row in joints])
        return command is not None and self.commands.write(command) > 0

    def send_hold(self, q: Sequence[float]) -> bool:
        """Send a command that holds the arm joints at the positions ``q``. Return True if it was sent."""
        joints = zip(self.model.joints, q, strict=True)
        command = self._command(
            [Motor(joint.mode, position, 0.0, 0.0, joint.kp, joint.kd) for joint, position in joints]
        )
        return command is not None and self.commands.write_stop(command) > 0

    def _command(self, arms: Sequence[Motor]) -> bytes | None:
        """Return the bytes of a command to the arms; None if the robot reports too few motors to
        have these arms."""
        state = self.state
        count = len(self.model.motors) if state is None else len(state.q)
        if count <= LAST_ARM:
            return None
        motors = [IDLE] * count
        for joint, motor in zip(self.model.joints, arms, strict=True):
            motors[joint.slot] = motor
        return CDR + p.encode_command(Command(self._command_type, tuple(motors)))

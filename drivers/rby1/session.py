"""One connection to an RB-Y1. It keeps the robot's limits and newest state, and sends our commands
as a stream."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.grpc import Call, Connection, OpenStream, open_grpc
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from .commands import Feedback, JointPosition, encode_command, split
from .config import RBY1Config
from .model import Limits, limits_of
from .protocol import Method, RobotInfo
from .states import RobotState

CONNECT_S = 1.0
HANDSHAKE_S = 1.0
STATE_HZ = 100.0


class RBY1Session:
    """The connection to the robot and its state, from ``open`` to ``close``."""

    def __init__(self, config: RBY1Config, connection: Connection, limits: Limits) -> None:
        self.connection = connection
        self.limits = limits
        self.state = RobotState(())
        self.stamp_ns = 0
        # Why no command is sent until the robot is armed again; empty if commands may be sent.
        self.lost = ""
        self._config = config
        self._states = connection.ask(Method.STATE_STREAM, p.encode_rate(STATE_HZ))
        self._command: Call | None = None

    def row(self, values: Sequence[float]) -> tuple[float, ...]:
        """Pick the driven joints from a list of all joints, with NaN where the list is too short."""
        return tuple(values[index] if index < len(values) else math.nan for index in self._config.ids)

    @property
    def ready(self) -> bool:
        """Whether the servos of all joints that this driver commands are on."""
        return all(index < len(self.state.ready) and self.state.ready[index] for index in self._config.ids)

    def silent_s(self, now_ns: int) -> float:
        """Return for how long the time in the robot's states has not advanced, in seconds."""
        return (now_ns - self.stamp_ns) / NS

    def take_waiting(self, now_ns: int) -> None:
        """Process the received messages, without waiting. Raise ``WireDown``."""
        self.connection.take_waiting()
        self._take_states(now_ns)
        self._take_feedback()

    async def next_state(self, clock: Clock, within_s: float) -> None:
        """Wait for a new state. Raise ``WireDown`` if the timeout ends first."""
        before_ns = self.stamp_ns
        with trio.move_on_after(within_s):
            while self.stamp_ns == before_ns:
                await self.connection.until(lambda: bool(self._states.messages) or self._ended, within_s)
                self._take_states(clock.now_ns())
        if self.stamp_ns == before_ns:
            raise WireDown(f"{self._config.robot}: no new state within {within_s:g} s. Check the robot")
        self._take_feedback()

    def command(self, values: Sequence[float]) -> bytes:
        """Encode a target of all driven joints as one command message."""
        parts = {
            name: JointPosition(row, self._config.period_s, self._config.hold_s)
            for name, row in split(values).items()
        }
        return encode_command(parts, self._config.priority)

    def send(self, message: bytes) -> None:
        """Send a command now, on the open stream or on a new one. Raise ``WireDown``."""
        if self._command is None:
            self._command = self.connection.call(Method.COMMAND_STREAM)
        self._command.send(message)

    def drop_stream(self) -> None:
        """Cancel the stream of commands, if there is one. Raise ``WireDown``."""
        command, self._command = self._command, None
        if command is not None:
            command.cancel()

    @property
    def _ended(self) -> bool:
        return self._states.status is not None

    def _take_states(self, now_ns: int) -> None:
        if self._states.messages:
            newest = self._states.messages.pop()
            self._states.messages.clear()
            try:
                state = RobotState.decode(newest)
            except MalformedFrame as malformed:
                raise WireDown(
                    f"{self._config.robot}: the robot sent an invalid state ({malformed}). Reconnect"
                ) from None
            if state.time_ns != self.state.time_ns:
                self.stamp_ns = now_ns
            self.state = state
        if self._ended:
            raise WireDown(
                f"{self._config.robot}: the robot sends no more states ({self._states.failure()}). Reconnect"
            )

    def _take_feedback(self) -> None:
        """Set ``lost`` if the robot has dropped the command or ended its stream."""
        command = self._command
        if command is None:
            return
        while command.messages:
            try:
                dropped = Feedback.decode(command.messages.popleft()).dropped
            except MalformedFrame as malformed:
                dropped = str(malformed)
            if dropped:
                self.lost = f"the robot has dropped our command: {dropped}"
        if command.status is not None:
            # An end with status OK counts as lost, too. A stream that we have ended ourselves is no longer in
            # ``_command`` here.
            self._command = None
            self.lost = self.lost or f"the stream of commands has ended: {command.failure()}"


async def open_session(
    config: RBY1Config, clock: Clock, open_stream: OpenStream
) -> tuple[RBY1Session, dict[str, Any]]:
    """Connect, read the robot's identity and limits, and wait for its first state. Nothing moves.

    Returns:
        The session, and facts about the robot, which the verb ``status`` shows.

    Raises:
        WireDown: The robot does not answer, or it is not the expected model.
    """
    host, port = _address(config)
    connection = await open_grpc(host, port, within_s=CONNECT_S, open_stream=open_stream)
    try:
        info = RobotInfo.decode(await connection.unary(Method.GET_ROBOT_INFO, b"", HANDSHAKE_S))
        _refuse_another(config, info)
        urdf = p.decode_model(await connection.unary(Method.GET_ROBOT_MODEL, b"", HANDSHAKE_S))
        limits = limits_of(urdf, config.axes)
        session = RBY1Session(config, connection, limits)
        await session.next_state(clock, HANDSHAKE_S)
    except MalformedFrame as malformed:
        connection.close()
        raise WireDown(f"open: {config.robot} at {config.port}: {malformed}. Update its software") from None
    except BaseException:
        connection.close()
        raise
    facts = {
        "address": connection.name,
        "model": info.model,
        "model_version": info.version,
        "supplies": list(info.supplies),
        "limits": "the robot's own model",
        "control_hold_time_s": config.hold_s,
    }
    return session, facts


def _refuse_another(config: RBY1Config, info: RobotInfo) -> None:
    """Raise ``WireDown`` if the robot has other joints than expected, or in another order. The
    values of a state carry no names, so their order must be right."""
    count = len(info.joints)
    rows = zip(config.axes, config.ids, strict=True)
    missing = [axis for axis, index in rows if index >= count or info.joints[index] != axis]
    if missing:
        raise WireDown(
            f"open: the robot at {config.port} reports model {info.model or '?'}, without {', '.join(missing)} "
            "where a model A has them. Use an RB-Y1 of model A"
        )


def _address(config: RBY1Config) -> tuple[str, int]:
    try:
        return config.address()
    except ValueError as error:
        raise WireDown(f"open: {error}") from None

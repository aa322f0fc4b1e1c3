"""Command and stop a mobile base that is reached through a service.

Such a base keeps its last speed until it receives another command. So each speed command has a lifetime. A stop
sends speed zero until the base reports that it does not move.

The service's answer to a command only means that the service has passed the command on. So the answer does not
confirm a stop. Only a report of the base confirms it, and only if the report was made so late that no command from
before the stop can still be on its way.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

from strands_actors.contract.axis import Axis, AxisMode, parse_action
from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.kernel.messages import Refused

from ..ports.http_port import HttpPort
from .rest_watch import Rest, RestWatch
from .stop_steps import repeat_until_safe

LIFETIME_S = 0.3
"""Lifetime of a command to a base."""

ANSWER_S = 0.2
"""Timeout of one zero, or of one state request. After it the next is sent on a new connection."""

AGAIN_S = 0.05
"""Pause between two zeros."""

OK = 200


def parse_twist(
    action: Mapping[str, object], robot: str, axes: Sequence[Axis], index: Mapping[str, int], state: GateState
) -> Candidate | Refused:
    """Convert an action, a dict by axis name, into a target for all axes of the base, or return a refusal.

    A speed that the action does not name becomes the axis's rest value. If the action names no speed at all (for
    example only a lamp), the last speeds continue, but not longer than their lifetime.
    """
    parsed = parse_action(action, robot, axes, index, state.target)
    if isinstance(parsed, Refused):
        return parsed
    values, named = parsed
    moving = [axis_index for axis_index, axis in enumerate(axes) if axis.mode is AxisMode.VELOCITY]
    live = state.live
    if live is None or live.over(state.now_ns) or any(axis_index in named for axis_index in moving):
        return Candidate(values, named)
    if all(state.target[axis_index] == axes[axis_index].rest for axis_index in moving):
        return Candidate(values, named)
    kept = tuple(
        state.target[axis_index] if axis_index in moving else value for axis_index, value in enumerate(values)
    )
    return Candidate(kept, named, live.until_ns or 0)


class MotionReport(NamedTuple):
    """One report that a mobile base has sent about its motion, with a time stamp and its speed."""

    stamp_s: float  # time of the report, by the base's clock
    speed: float


class StopRequests(Protocol):
    """The HTTP requests that stop a mobile base and read whether it moves. They are sent to the service (the
    program) through which the base is reached."""

    @property
    def target(self) -> str:
        """Path of the ``POST`` request that stops the base."""
        ...

    @property
    def body(self) -> bytes: ...
    @property
    def state_target(self) -> str:
        """Path of the ``GET`` request that returns the state of the base."""
        ...

    @property
    def steady_s(self) -> float:
        """For how long the base must report speed 0 before it counts as stopped, in seconds of its own clock.

        During this time an earlier command may still arrive, and an old report may be received. With 0 a single
        report is enough: such a service answers a command only after the base has received it.
        """
        ...

    def read_motion(self, body: bytes) -> MotionReport:
        """Decode the report of the base's motion in ``body``, the body of a response.

        Raises:
            MalformedFrame: The response cannot be decoded.
        """
        ...


def nothing_pending() -> bool:
    """Default of the argument ``pending`` of ``stop_base``. Always return False (no earlier command is
    unanswered)."""
    return False


async def stop_base(
    port: HttpPort, requests: StopRequests, within_s: float, pending: Callable[[], bool] = nothing_pending
) -> Outcome:
    """Send the stop command repeatedly, until the base has reported speed 0 for ``requests.steady_s``.

    Never raises. If a connection is open, the first stop command leaves before this function waits for anything,
    even if malformed data was received on this connection.

    Args:
        port: The connection. It is opened again when it fails.
        requests: The requests of this service.
        within_s: Longest time of the whole stop.
        pending: Return True if a command on another connection was sent before and is not answered yet. The base
            may carry it out after the stop, so earlier reports do not count.
    """
    stop = _ServiceStop(port, requests, pending)
    stop.send_if_malformed()
    return await repeat_until_safe(stop, within_s, AGAIN_S)


class _ServiceStop:
    """The steps of one stop of a mobile base that is reached through a service. Implements ``StopSteps``."""

    def __init__(self, port: HttpPort, requests: StopRequests, pending: Callable[[], bool]) -> None:
        self._port = port
        self._requests = requests
        self._pending = pending
        self._watch = RestWatch(steady=requests.steady_s)
        self.written = self.acknowledged = False

    def send_if_malformed(self) -> None:
        """Send the stop command on a connection that counts as closed because malformed data was received on
        it."""
        if not self._port.is_open:
            with contextlib.suppress(WireDown):
                self._port.send_stop("POST", self._requests.target, self._requests.body)
                self.written = True

    async def step(self) -> str:
        """Send a stop command. After its answer, request a report of the motion."""
        port, requests = self._port, self._requests
        if not port.is_open:
            await port.open()
        number = port.send("POST", requests.target, requests.body)
        self.written = True
        reply = await port.answer(number, ANSWER_S)
        if reply.status != OK:
            raise WireDown(
                f"{port.name}: the service answered a stop with HTTP status {reply.status}. Check the service"
            )
        self.acknowledged = True
        answer = await port.ask("GET", requests.state_target, within_s=ANSWER_S)
        report = requests.read_motion(answer.body)
        if self._pending():
            self._watch.restart()
            return "not confirmed: an earlier command has not been answered"
        self._watch.report(report.stamp_s, moving=[0] if report.speed != 0 else [])
        match self._watch.rest:
            case Rest.RESTS:
                return ""
            case Rest.MOVES:
                return f"not confirmed: it reports speed {report.speed:g}"
            case Rest.TOO_SHORT:
                return f"not confirmed: it must report speed 0 for {requests.steady_s:g} s"
            case Rest.NOTHING_SINCE:
                return f"not confirmed: {Rest.NOTHING_SINCE.value}"

"""Bases behind a service: a twist has a lifetime, and a stop sends zero until the base reports that it
stands.

Such a base runs its last command until it receives another. The answer to a command says only that the
service has passed it on, not that the base has received it. So the answer to a stop does not confirm
it. Reports of the base confirm it, if they cover the time in which an earlier command may still arrive.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

import trio

from strands_actors.contract.axis import Axis, AxisMode, parse_action
from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.kernel.messages import Refused

from ..codecs.malformed import MalformedFrame
from ..ports.http_port import HttpPort

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
    """Return the whole target of an action.

    An axis that moves the base goes to its rest value unless the action names it. An action that names
    no such axis (only a lamp, for example) keeps the live twist, until the time that was promised for
    that twist.
    """
    parsed = parse_action(action, robot, axes, index, state.target)
    if isinstance(parsed, Refused):
        return parsed
    values, named = parsed
    moving = [at for at, axis in enumerate(axes) if axis.mode is AxisMode.VELOCITY]
    live = state.live
    if live is None or live.over(state.now_ns) or any(at in named for at in moving):
        return Candidate(values, named)
    if all(state.target[at] == axes[at].rest for at in moving):
        return Candidate(values, named)
    kept = tuple(state.target[at] if at in moving else value for at, value in enumerate(values))
    return Candidate(kept, named, live.until_ns or 0)


class Standing(NamedTuple):
    """The report of a base about its motion."""

    stamp_s: float  # the base's clock
    speed: float


class Zero(Protocol):
    """The requests of one service that stop its base, and that read whether it stands."""

    @property
    def target(self) -> str:
        """Target of the ``POST`` that stops the base."""
        ...

    @property
    def body(self) -> bytes: ...
    @property
    def state_target(self) -> str:
        """Target of the ``GET`` that returns the state of the base."""
        ...

    @property
    def steady_s(self) -> float:
        """For how long a base must report speed 0, in seconds by the clock of the base, before it counts as
        standing.

        It covers a command that left before the stop and arrives late, and the age of a report. With 0
        one report is enough: the base has received each command before it is answered.
        """
        ...

    def standing(self, body: bytes) -> Standing:
        """Return the report in a response.

        Raises:
            MalformedFrame: The response cannot be read.
        """
        ...


def nothing_pending() -> bool:
    """Return False, for a sender that cannot know of earlier commands."""
    return False


async def stop_base(
    port: HttpPort, zero: Zero, within_s: float, pending: Callable[[], bool] = nothing_pending
) -> Outcome:
    """Send zero repeatedly, until newer reports show speed 0 for ``zero.steady_s`` without a break.

    Never raises. If a connection is open, the first zero leaves before the first wait, even if
    something unreadable was received on it.

    Args:
        port: The connection. It is reopened when it fails.
        zero: The requests of this service.
        within_s: Time for everything.
        pending: Return True if an earlier command, sent on another connection, is unanswered. The base
            may carry it out after a zero, so reports from before its answer prove nothing.
    """
    written = acknowledged = False
    detail = "silent"
    # Stamp of the newest report. It starts with the first report that was requested after a zero was taken.
    newest_s: float | None = None
    rests_s: float | None = None  # since when the base has reported speed 0
    if not port.is_open:
        # ``is_open`` is also False if something unreadable was received. Such a connection still takes a zero.
        with contextlib.suppress(WireDown):
            port.send_stop("POST", zero.target, zero.body)
            written = True
    with trio.move_on_after(within_s):
        while True:
            try:
                if not port.is_open:
                    await port.open()
                number = port.send("POST", zero.target, zero.body)
                written = True
                reply = await port.answer(number, ANSWER_S)
                if reply.status != OK:
                    raise WireDown(f"{port.name}: a stop is answered with status {reply.status}. Check the service")
                acknowledged = True
                answer = await port.ask("GET", zero.state_target, within_s=ANSWER_S)
                stands = zero.standing(answer.body)
                if pending():
                    newest_s = rests_s = None
                    detail = "not confirmed: an earlier command has not been answered"
                elif newest_s is None:
                    newest_s, detail = stands.stamp_s, "not confirmed: it has reported nothing since"
                elif stands.stamp_s > newest_s:
                    newest_s = stands.stamp_s
                    if stands.speed != 0:
                        rests_s, detail = None, f"not confirmed: it reports speed {stands.speed:g}"
                    else:
                        rests_s = newest_s if rests_s is None else rests_s
                        if newest_s - rests_s >= zero.steady_s:
                            return Outcome(True, True, "")
                        detail = f"not confirmed: it has reported speed 0 for {newest_s - rests_s:.2g} s only"
            except MalformedFrame as malformed:
                detail = f"not confirmed: {malformed}"
            except WireDown as down:
                detail = f"not confirmed: {down}"
            await trio.sleep(AGAIN_S)
    return Outcome(written, acknowledged, detail)

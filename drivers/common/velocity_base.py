"""Bases behind a service: a twist with a lifetime, zero when it ends, and zero again until the base
says it stands.

Such a base runs its last command until it hears another one, and an answer says that a command was
passed on, not that the base has it. So a stop is not confirmed by its answer, but by what the base
reports afterwards, for as long as an earlier command may still come.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

import trio

from strands_actors.contract.axis import Axis, AxisMode, parse_action
from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.outcome import Outcome
from strands_actors.kernel.messages import Refused

from .http_port import HttpPort
from .malformed import MalformedFrame

LIFETIME_S = 0.3
"""Of a command to a base."""

ANSWER_S = 0.2
"""How long one zero, or one look at the base, waits for its answer before the next is sent on a new
connection."""

AGAIN_S = 0.05
"""Pause between two zeros."""

OK = 200


def parse_twist(
    action: Mapping[str, object], robot: str, axes: Sequence[Axis], index: Mapping[str, int], state: GateState
) -> Candidate | Refused:
    """Return the whole target. What moves the base rests unless it is named; but an action that
    names nothing that moves it (a lamp) goes on with the twist that is live, for as long as that
    was promised and no longer."""
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
    """What a base reports of itself."""

    stamp_s: float  # the base's clock
    speed: float


class Zero(Protocol):
    """How one service is told to stop, and asked whether its base does."""

    @property
    def target(self) -> str:
        """Of the ``POST`` that stops."""
        ...

    @property
    def body(self) -> bytes: ...
    @property
    def state_target(self) -> str:
        """Of the ``GET`` that tells how the base stands."""
        ...

    @property
    def steady_s(self) -> float:
        """For how long, by its own clock, a base must report speed 0 until it stands: a command
        that left before the stop may come to it so late, and what it reports be so old. 0: one
        report counts, where a command is there when it is answered."""
        ...

    def standing(self, body: bytes) -> Standing:
        """Raise ``MalformedFrame``."""
        ...


def nothing_pending() -> bool:
    """Of who cannot know of earlier commands."""
    return False


async def stop_base(
    port: HttpPort, zero: Zero, within_s: float, pending: Callable[[], bool] = nothing_pending
) -> Outcome:
    """Send zero, again and again, until newer reports show speed 0, without a break for
    ``zero.steady_s``. Never raises. Where a connection is open, the first zero leaves before the
    first wait, whatever has come on it.

    ``pending``: whether a command sent earlier, on another connection, has not been answered: it
    may be carried out after a zero, so what is reported before it was answered proves nothing.
    """
    written = acknowledged = False
    detail = "silent"
    newest_s: float | None = None  # at first that of the report that was asked for after a zero was taken
    rests_s: float | None = None  # since when it has reported speed 0
    if not port.is_open:
        with contextlib.suppress(WireDown):  # nothing is open, not even one that is not understood
            port.send_stop("POST", zero.target, zero.body)
            written = True
    with trio.move_on_after(within_s):
        while True:
            try:
                if not port.is_open:
                    await port.open()
                number = port.send("POST", zero.target, zero.body)
                written = True
                told = await port.answer(number, ANSWER_S)
                if told.status != OK:
                    raise WireDown(f"{port.name}: a stop is answered with status {told.status}. Check the service")
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

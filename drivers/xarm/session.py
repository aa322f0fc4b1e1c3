"""One connection to a controller: opening it, its two streams, and the newest data from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.ports.receive_budget import ReceiveBudget
from strands_actors.kernel.clock import NS, Clock

from . import protocol as p
from . import reports as r
from .arms import AXES, ArmType
from .config import XArmConfig
from .control import Control, OpenStream, Stream, open_control
from .protocol import Mode, Register, State

HANDSHAKE_S = 0.6
"""Timeout of a first reply or report. It is longer than a controller may be silent, so that one that
accepts the connection but never sends is reported as such."""

LIMIT_S = 0.5
"""Timeout for the first rich report. They come five times per second."""

HELD_RAD = 0.01
"""An arm this near to its target counts as holding it [assumed]."""
PAST_RAD = 0.02
"""A joint that was braked at its limit may rest this far outside its range and still be armed. Its first
target is then the end of its range, one step of a stream away [assumed]."""

_MOVABLE = (State.MOVING, State.READY)


class XArmSession:
    """The state that exists between ``open`` and ``close``."""

    def __init__(self, control: Control, kind: ArmType, limit_rad_s: float, reports: Stream, name: str) -> None:
        self.control = control
        self.kind = kind
        self.limit_rad_s = limit_rad_s
        self.target: tuple[float, ...] = ()  # the last written target since the arm was armed
        self.stops: set[int] = set()  # numbers of the stop requests since the link was lost
        self.report: r.Report
        self.stamp_ns = 0  # when the report arrived
        self.asked_ns = 0  # when the errors were requested
        self._reports = reports
        self._name = name
        self._decoder = r.ReportDecoder()
        self._budget = ReceiveBudget(name)

    def take_waiting(self, now_ns: int) -> None:
        """Process the data that has arrived on both connections. Raise ``WireDown``."""
        self.control.take_waiting()
        for data in self._budget.turn(self._reports.read_waiting):
            self._take(data, now_ns)

    async def next_report(self, clock: Clock, within_s: float) -> bool:
        """Wait for a new report. Return whether one arrived in time. Raise ``WireDown``."""
        before_ns = self.stamp_ns
        with trio.move_on_after(within_s):
            while self.stamp_ns == before_ns:
                self._take(await self._reports.read(), clock.now_ns())
        return self.stamp_ns != before_ns

    def silent_s(self, now_ns: int) -> float:
        """Return the time without a report or without an outstanding reply, whichever is longer."""
        return max((now_ns - self.stamp_ns) / NS, self.control.silent_s(now_ns))

    def close(self) -> None:
        self.control.close()
        self._reports.close()

    def within_range(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return the target, limited to the arm's range.

        For a target that is outside by 0.001 rad or more the controller ends the motion with an error. The gates
        let such a target pass if the joint already rests there.
        """
        ranges = zip(values, self.kind.range_rad, strict=True)
        return tuple(min(high, max(low, rad)) for rad, (low, high) in ranges)

    def past_range(self) -> str:
        """Return which joint rests too far outside its range to be armed; empty if all are near enough."""
        rows = zip(AXES, self.report.position_rad, self.within_range(self.report.position_rad), strict=True)
        return next(
            (f"{axis} is {abs(rad - end):.3f} rad" for axis, rad, end in rows if abs(rad - end) > PAST_RAD), ""
        )

    @property
    def movable(self) -> bool:
        """Whether the arm would follow a target."""
        return self.report.mode == Mode.SERVO and self.report.state in _MOVABLE

    def held_at(self, target: tuple[float, ...]) -> bool:
        """Return whether the arm is at ``target``."""
        pairs = zip(self.report.position_rad, target, strict=True)
        return all(abs(rad - goal) <= HELD_RAD for rad, goal in pairs)

    def _take(self, data: bytes, now_ns: int) -> None:
        try:
            for report in self._decoder.feed(data):
                self.report, self.stamp_ns = r.parse_report(report), now_ns
        except MalformedFrame as malformed:
            raise WireDown(f"{self._name}: its reports cannot be understood ({malformed}). Reconnect") from None


async def open_session(
    config: XArmConfig, clock: Clock, open_stream: OpenStream
) -> tuple[XArmSession, dict[str, Any]]:
    """Connect, read version, errors and speed limit, and wait for the first report. Only read requests are sent.

    Returns:
        The session, and facts for ``status``.

    Raises:
        WireDown: The controller does not answer, or the arm is of another type.
    """
    control = await open_control(config, clock, open_stream)
    try:
        version = await _ask_version(config, control)
        kind = config.kind_of(version)
        if await control.ask(Register.ERRORS, within_s=HANDSHAKE_S) is None:
            raise WireDown(f"{config.robot} at {config.port}: does not say its errors. Restart the controller")
        reported = await _read_speed_limit(config, open_stream)
        limit_rad_s = reported or config.arm.speed_rad_s
        stream = await open_stream(config.host, r.REAL_PORT)
    except BaseException:
        control.close()
        raise
    name = f"{config.robot} at {config.host}:{r.REAL_PORT}"
    session = XArmSession(control, kind, limit_rad_s, stream, name)
    try:
        if not await session.next_report(clock, HANDSHAKE_S):
            raise WireDown(f"{name}: connected, but no report. Restart the controller")
    except BaseException:
        session.close()
        raise
    return session, {
        "address": config.port,
        "firmware": version.text,
        "arm_type": version.arm_type,
        "serial": version.serial,
        "speed_limit_rad_s": round(limit_rad_s, 4),
        "speed_limit": "the controller's" if reported else "not told by the controller: assumed",
    }


async def _ask_version(config: XArmConfig, control: Control) -> p.Version:
    name = f"{config.robot} at {config.port}"
    reply = await control.ask(Register.VERSION, within_s=HANDSHAKE_S)
    if reply is None:
        raise WireDown(f"{name}: connected, but no answer. Is it an xArm's controller? Restart it")
    try:
        return p.parse_version(reply.data)
    except MalformedFrame as malformed:
        raise WireDown(f"{name}: {malformed}. Update its firmware") from None


async def _read_speed_limit(config: XArmConfig, open_stream: OpenStream) -> float | None:
    """Return the controller's own limit from its rich report, in rad/s; None if the report has no limit."""
    decoder = r.ReportDecoder()
    with trio.move_on_after(LIMIT_S):
        try:
            stream = await open_stream(config.host, r.RICH_PORT)
            try:
                while True:
                    for report in decoder.feed(await stream.read()):
                        return r.speed_limit_of(report)
            finally:
                stream.close()
        except (WireDown, MalformedFrame):
            pass  # The table's limit is used then, and status shows that.
    return None

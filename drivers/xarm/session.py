"""One connection to a controller: how it is opened, its requests and reports, and the newest data."""

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

AT_TARGET_RAD = 0.01
"""An arm whose joints are all this near to its target counts as holding it [assumed]."""
PAST_RAD = 0.02
"""A joint that was stopped at its limit may rest this far outside its range and can still be energised. Its first
target is then the limit itself, which is one step of a stream away [assumed]."""

_MOVABLE = (State.MOVING, State.READY)


class XArmSession:
    """An open connection to a controller. It is made by ``open`` and ends with ``close``."""

    def __init__(self, control: Control, arm_type: ArmType, limit_rad_s: float, reports: Stream, name: str) -> None:
        self.control = control
        self.arm_type = arm_type
        self.limit_rad_s = limit_rad_s
        self.target: tuple[float, ...] = ()  # last target that was sent since the arm was energised; empty before
        self.stops: set[int] = set()  # numbers of the stop requests that were sent on this lost link
        self.report: r.Report
        self.stamp_ns = 0  # when the newest report arrived
        self.errors_requested_ns = 0  # when the errors were last requested
        self._reports = reports
        self._name = name
        self._decoder = r.ReportDecoder()
        self._budget = ReceiveBudget(name)

    def take_waiting(self, now_ns: int) -> None:
        """Process received data of both connections. Raise ``WireDown`` for a lost link or invalid data."""
        self.control.take_waiting()
        for data in self._budget.turn(self._reports.read_waiting):
            self._take(data, now_ns)

    async def next_report(self, clock: Clock, within_s: float) -> bool:
        """Wait for a new report. Return True if one came in time. Raise ``WireDown`` for a lost link."""
        before_ns = self.stamp_ns
        with trio.move_on_after(within_s):
            while self.stamp_ns == before_ns:
                self._take(await self._reports.read(), clock.now_ns())
        return self.stamp_ns != before_ns

    def silent_s(self, now_ns: int) -> float:
        """Return for how many seconds no report has come, or a request has waited for its reply. The longer time
        counts."""
        return max((now_ns - self.stamp_ns) / NS, self.control.silent_s(now_ns))

    def close(self) -> None:
        self.control.close()
        self._reports.close()

    def within_range(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return the target, limited to the arm's range.

        A target outside the range by 0.001 rad or more makes the controller end the motion with an error. The gates
        permit such a target if the joint already rests there, so it is limited here.
        """
        ranges = zip(values, self.arm_type.range_rad, strict=True)
        return tuple(min(high, max(low, rad)) for rad, (low, high) in ranges)

    def past_range(self) -> str:
        """Return the joint that rests too far outside its range to be energised; empty if all are near enough."""
        rows = zip(AXES, self.report.position_rad, self.within_range(self.report.position_rad), strict=True)
        return next(
            (f"{axis} is {abs(rad - end):.3f} rad" for axis, rad, end in rows if abs(rad - end) > PAST_RAD), ""
        )

    @property
    def movable(self) -> bool:
        """Return True if the arm would follow a target now."""
        return self.report.mode == Mode.SERVO and self.report.state in _MOVABLE

    def is_at(self, target: tuple[float, ...]) -> bool:
        """Return True if every joint is at ``target``, within ``AT_TARGET_RAD``."""
        pairs = zip(self.report.position_rad, target, strict=True)
        return all(abs(rad - goal) <= AT_TARGET_RAD for rad, goal in pairs)

    def _take(self, data: bytes, now_ns: int) -> None:
        try:
            for report in self._decoder.feed(data):
                self.report, self.stamp_ns = r.parse_report(report), now_ns
        except MalformedFrame as malformed:
            raise WireDown(
                f"{self._name}: the controller sent an invalid report ({malformed}). Reconnect"
            ) from None


async def open_session(
    config: XArmConfig, clock: Clock, open_stream: OpenStream
) -> tuple[XArmSession, dict[str, Any]]:
    """Connect, read version, errors and speed limit, and wait for the first report. Nothing on the arm is changed.

    Returns:
        The session, and facts for ``status``.

    Raises:
        WireDown: The controller does not answer, or the arm is of another type.
    """
    control = await open_control(config, clock, open_stream)
    try:
        version = await _ask_version(config, control)
        arm_type = config.find_arm_type(version)
        if await control.ask(Register.ERRORS, within_s=HANDSHAKE_S) is None:
            raise WireDown(
                f"{config.robot} at {config.port}: the controller did not answer the request for its errors. "
                "Restart it"
            )
        reported = await _read_speed_limit(config, open_stream)
        limit_rad_s = reported or config.arm.speed_rad_s
        stream = await open_stream(config.host, r.REAL_PORT)
    except BaseException:
        control.close()
        raise
    name = f"{config.robot} at {config.host}:{r.REAL_PORT}"
    session = XArmSession(control, arm_type, limit_rad_s, stream, name)
    try:
        if not await session.next_report(clock, HANDSHAKE_S):
            raise WireDown(f"{name}: the port is open, but no report came. Restart the controller")
    except BaseException:
        session.close()
        raise
    return session, {
        "address": config.port,
        "firmware": version.text,
        "arm_type": version.arm_type,
        "serial": version.serial,
        "speed_limit_rad_s": round(limit_rad_s, 4),
        "speed_limit": "the controller's" if reported else "assumed, since the controller does not report it",
    }


async def _ask_version(config: XArmConfig, control: Control) -> p.Version:
    name = f"{config.robot} at {config.port}"
    reply = await control.ask(Register.VERSION, within_s=HANDSHAKE_S)
    if reply is None:
        raise WireDown(
            f"{name}: the port is open, but nothing answers. Check that it is an xArm's controller, or restart it"
        )
    try:
        return p.parse_version(reply.data)
    except MalformedFrame as malformed:
        raise WireDown(f"{name}: {malformed}. Update the controller's firmware") from None


async def _read_speed_limit(config: XArmConfig, open_stream: OpenStream) -> float | None:
    """Return the controller's joint speed limit from its rich report, in rad/s; None if the report has none."""
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
            # The speed limit in the robot's table is used instead, and the status shows it.
            pass
    return None

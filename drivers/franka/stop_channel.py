"""The root's stop channel to the arm. It is used after the wire process has ended.

The wire's connection ends with its process, and a controller ends a motion together with the connection that
began it. The stop channel only has to check that. It connects when it is needed, and sends a StopMove for the
case that another client moves the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from strands_actors.contract.stop_channels import WatchedFirmware
from strands_actors.contract.wire import MotorReport, WireDown

from . import protocol as p
from .client import LOOK_S, Fci, open_client
from .config import FrankaConfig

STANDING_RAD_S = 0.02
CONFIRM_S = 0.6
"""Longest time until the arm stands still. From top speed a joint needs 0.3 s at its acceleration."""


class StopWatch:
    """A connection on which a stop was sent, to observe its effect.

    Args:
        config: The arm's settings.
        client: The connection.
        first: The first state on it.
        stop: The number of the stop request.
    """

    def __init__(self, config: FrankaConfig, client: Fci, first: p.State, stop: int) -> None:
        self._config = config
        self._client = client
        self._first = first
        self._stop = stop
        self._acknowledged = False
        self._state: p.State | None = None

    def look(self) -> tuple[MotorReport, ...]:
        self._acknowledged = self._acknowledged or any(reply.id == self._stop for reply in self._client.replies())
        newest = self._client.newest_state()
        if newest is not None and newest.message_id > self._first.message_id:
            self._state = newest  # The time of a live controller advances.
        return self.reports("" if self._state is not None else "the controller's time stamp stands still")

    def reports(self, trouble: str) -> tuple[MotorReport, ...]:
        return reports(self._config, True, self._acknowledged, self._state, trouble)

    def close(self) -> None:
        self._client.close_in_order()


class FrankaStopChannel(WatchedFirmware[FrankaConfig, StopWatch]):
    CONFIRM_S: ClassVar[float] = CONFIRM_S
    LOOK_S: ClassVar[float] = LOOK_S
    _told = False  # whether the last connection took the stop

    @property
    def hosts(self) -> Sequence[str]:
        return (self.config.host,)

    async def connect(self) -> StopWatch:
        """Connect and send the stop before the controller has answered anything. Then wait for a state."""
        config, self._told = self.config, False
        try:
            host = config.host
        except ValueError as error:
            raise WireDown(str(error)) from None
        client = await open_client(host, config.arm.fci)
        try:
            stop = client.greet_and_stop()
            self._told = True
            return StopWatch(config, client, await client.handshake(config.robot), stop)
        except BaseException:
            client.close_in_order()  # A frozen controller still receives the stop when it continues.
            raise

    def failed(self, why: str, watch: StopWatch | None = None) -> tuple[MotorReport, ...]:
        return reports(self.config, self._told, False, None, why) if watch is None else watch.reports(why)


def moving(state: p.State) -> list[int]:
    """Return the joints that may move: all of them while the controller runs a motion."""
    if state.robot_mode == p.RobotMode.MOVE:
        return list(range(len(state.dq)))
    return [at for at, rad_s in enumerate(state.dq) if abs(rad_s) >= STANDING_RAD_S]


def reports(
    config: FrankaConfig, written: bool, acknowledged: bool, state: p.State | None, trouble: str = ""
) -> tuple[MotorReport, ...]:
    """Return a report per joint. ``state`` is the last one since the stop was written; None without one."""
    moves: Sequence[int] = range(len(config.arm.keys)) if state is None else moving(state)
    results = []
    for at, joint in enumerate(config.arm.keys):
        safe = state is not None and at not in moves
        detail = "" if safe else trouble or "it moves"
        if safe and state is not None and state.robot_mode not in (p.RobotMode.IDLE, p.RobotMode.MOVE):
            detail = ", ".join((p.mode_name(state.robot_mode), *state.reasons))
        results.append(MotorReport(joint, at + 1, written, acknowledged, safe, detail))
    return tuple(results)

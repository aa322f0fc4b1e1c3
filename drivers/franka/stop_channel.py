"""The stop channel to the arm: the supervising process (root) stops the arm after the wire process has ended.

The connection of the wire process ends with this process, and the controller then ends the motion by itself. The
stop channel only has to check that the arm stands still. It connects when it is needed. It also sends a StopMove,
because another client may move the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.stop_channels import WatchedFirmware
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.common.kit.hand import AXIS as HAND
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED, Outcome

from . import protocol as p
from .client import LOOK_S, Fci, open_client
from .config import FrankaConfig
from .grippers import HAND_ID
from .hand import keep_grip

STANDING_RAD_S = 0.02
CONFIRM_S = 0.6
"""Longest time until the arm stands still. From top speed a joint needs 0.3 s at its acceleration."""


class StopWatch:
    """A connection on which a stop was sent, to observe its effect.

    Args:
        config: The arm's settings.
        client: The connection.
        first: The first state that was received on this connection.
        stop: The number of the stop request that was sent on it.
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
        if newest is not None and newest.message_id > (self._state or self._first).message_id:
            self._state = newest  # A later time stamp proves that the controller is not frozen.
        return self.reports("" if self._state is not None else "the time stamp of the controller does not advance")

    def reports(self, trouble: str) -> tuple[MotorReport, ...]:
        return reports(self._config, True, self._acknowledged, self._state, trouble)

    def close(self) -> None:
        self._client.close_in_order()


class FrankaStopChannel(WatchedFirmware[FrankaConfig, StopWatch]):
    CONFIRM_S: ClassVar[float] = CONFIRM_S
    LOOK_S: ClassVar[float] = LOOK_S
    _stop_sent = False  # True if the stop was sent on the last connection.

    @property
    def hosts(self) -> Sequence[str]:
        return (self.config.host,)

    async def connect(self) -> StopWatch:
        """Connect, and send the stop at once, without waiting for a reply. Then wait for a state."""
        config, self._stop_sent = self.config, False
        try:
            host = config.host
        except ValueError as error:
            raise WireDown(str(error)) from None
        client = await open_client(host, config.arm.fci)
        try:
            stop = client.greet_and_stop()
            self._stop_sent = True
            return StopWatch(config, client, await client.handshake(config.robot), stop)
        except BaseException:
            client.close_in_order()  # A frozen controller still receives the stop when it continues.
            raise

    async def make_safe_by(self, watch: StopWatch, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Watch the arm until it stands, and meanwhile stop fingers that move."""
        if not self.config.gripper:
            return await super().make_safe_by(watch, safe_state)
        grip = NOT_CONNECTED

        async def keep() -> None:
            nonlocal grip
            grip = await keep_grip(self.config.host, self.clock)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(keep)
            motors = await super().make_safe_by(watch, safe_state)
        return (*motors, *hand_report(grip))

    def failed(self, reason: str, watch: StopWatch | None = None) -> tuple[MotorReport, ...]:
        if watch is not None:
            motors = watch.reports(reason)
        else:
            motors = reports(self.config, self._stop_sent, False, None, reason)
        return (*motors, *hand_report(Outcome(False, False, reason))) if self.config.gripper else motors


def hand_report(grip: Outcome, target: float | None = None) -> tuple[MotorReport, ...]:
    """Return the report on the stop of the hand. ``target`` is the opening at which it stays."""
    return grip.reports((HAND,), (HAND_ID,), (target,))


def moving(state: p.State) -> list[int]:
    """Return the indices of the joints that are moving or could move. While the controller runs a motion, these
    are all joints."""
    if state.robot_mode == p.RobotMode.MOVE:
        return list(range(len(state.dq)))
    return [index for index, rad_s in enumerate(state.dq) if abs(rad_s) >= STANDING_RAD_S]


def reports(
    config: FrankaConfig, written: bool, acknowledged: bool, state: p.State | None, trouble: str = ""
) -> tuple[MotorReport, ...]:
    """Return a report on the stop of each joint.

    ``state`` is the newest state since the stop was sent, or None if no state has arrived since.
    """
    moves: Sequence[int] = range(len(config.arm.keys)) if state is None else moving(state)
    results = []
    for index, joint in enumerate(config.arm.keys):
        safe = state is not None and index not in moves
        detail = "" if safe else trouble or "the joint moves"
        if safe and state is not None and state.robot_mode not in (p.RobotMode.IDLE, p.RobotMode.MOVE):
            detail = ", ".join((p.mode_name(state.robot_mode), *state.reasons))
        results.append(MotorReport(joint, index + 1, written, acknowledged, safe, detail))
    return tuple(results)

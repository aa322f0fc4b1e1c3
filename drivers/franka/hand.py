"""The Franka Hand, as the wire process and the root's stop channel see it.

Theory. The hand has a separate service, with one request at a time, and answers a motion when it has ended. So a
new target while the fingers move needs a stop first, and is sent after the stop was answered. A closing to 0 % is a
grasp, with a force, and closes onto an object between the fingers. Any other target is a motion to a width.

A stop keeps the grip. The service's stop is sent only while the fingers move, because the vendor does not say
whether it also ends the force of a grasp. The driver assumes that it may [assumed].
"""

from __future__ import annotations

import math

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.kit.hand import FULL, UNNAMED
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.kernel.clock import NS, Clock

from . import hand_protocol as p
from .client import LOOK_S
from .config import FrankaConfig
from .grippers import FASTEST_M_S, SLOWEST_M_S, STRONGEST_N, WEAKEST_N, share
from .hand_client import STANDS_S, HandClient, connect_hand
from .hand_protocol import Command, Status

WRITE_EVERY_S = 0.05
"""Least time between two targets, in seconds."""
SILENT_S = 0.5
"""The hand counts as lost after this time without a state. It sends some sixty states a second [assumed]."""
CONFIRM_S = 0.6
"""Longest time until moving fingers stand after a stop."""
EMPTY_M = 0.002
"""Fingers that are closer than this hold nothing [assumed]."""
INNER_M, OUTER_M = 0.005, 1.0
"""A grasp succeeds at every width, because the width of the object is not known before."""

NOT_CONNECTED = "it is not connected"
NOT_HOMED = "it was not homed since its fingers were changed: run the service home_gripper first"


class FrankaHand:
    """The hand, as the wire process sees it."""

    def __init__(self, config: FrankaConfig, clock: Clock) -> None:
        self._config, self._clock = config, clock
        self._client: HandClient | None = None
        self._motion: int | None = None  # number of the motion that has no reply yet
        self._stop: int | None = None  # number of a stop that has no reply yet
        self._last: tuple[float, ...] | None = None  # opening, speed and force of the last command
        self._statuses: list[int] = []  # status of the last motion, if it has ended
        self._written_ns = 0
        self._fault = ""

    @property
    def opening(self) -> float:
        """Percent open; not a number while it is unknown."""
        state = None if self._client is None else self._client.state
        if state is None or state.most_m <= 0.0:
            return math.nan
        return min(max(FULL * state.width_m / state.most_m, 0.0), FULL)

    @property
    def stamp_ns(self) -> int:
        return 0 if self._client is None else self._client.stamp_ns

    @property
    def contact(self) -> float:
        """1 if it holds something, 0 if not."""
        state = None if self._client is None else self._client.state
        return math.nan if state is None else float(state.is_grasped and state.width_m > EMPTY_M)

    @property
    def fault(self) -> str:
        client = self._client
        if self._fault or client is None or client.state is None:
            return self._fault or NOT_CONNECTED
        return "" if client.state.most_m > 0.0 else NOT_HOMED

    async def open(self) -> None:
        """Connect. Raise ``WireDown`` if the hand does not answer."""
        self.close()
        try:
            self._client = await connect_hand(self._config.host, self._clock)
        except WireDown as down:
            raise WireDown(f"open: {down}. Check the hand in Desk, or leave gripper= out") from None
        self._fault = ""

    async def arm(self) -> None:
        """Forget the last target. Connect again after a fault. Raise ``WireDown`` if the hand does not answer."""
        self._last = None
        if self._client is None or self._fault:
            await self.open()

    def read(self, now_ns: int) -> None:
        """Take the received replies and states. Never waits and never raises."""
        client = self._client
        if client is None:
            return
        try:
            client.look()
        except WireDown as down:
            self._lose(str(down))
            return
        if now_ns - client.stamp_ns > SILENT_S * NS:
            self._fault = f"it has sent no state for {SILENT_S:g} s"
        if self._stop is not None and client.statuses.pop(self._stop, None) is not None:
            self._stop = None
        status = None if self._motion is None else client.statuses.pop(self._motion, None)
        if status is not None:
            self._motion, self._statuses = None, [status]
            if status == Status.FAIL:
                self._fault = "it has refused a motion (fail)"

    def follow(self, values: tuple[float, ...], permit: Permit) -> None:
        """Send a target (opening, speed and force in percent), if it is new and the hand can take one.

        While an earlier motion runs, that one is stopped, and a later call sends the target.
        """
        client, now_ns = self._client, self._clock.now_ns()
        opening, speed, force = values
        if speed == UNNAMED or client is None or client.state is None or values == self._last:
            return
        if now_ns - self._written_ns < WRITE_EVERY_S * NS or self.fault:
            return
        permit.check()
        if self._motion is not None:
            self._stop = client.send(Command.STOP) if self._stop is None else self._stop
            return
        m_s = share(speed, SLOWEST_M_S, FASTEST_M_S)
        if opening:
            self._motion = client.send(Command.MOVE, p.move_payload(client.state.most_m * opening / FULL, m_s))
        else:
            newtons = share(force, WEAKEST_N, STRONGEST_N)
            self._motion = client.send(Command.GRASP, p.grasp_payload(0.0, INNER_M, OUTER_M, m_s, newtons))
        self._last, self._written_ns = values, now_ns

    async def home(self, permit: Permit) -> int:
        """Open and close the hand, which measures its stroke. Return the status of the reply.

        Raises:
            WireDown: The connection is lost.
        """
        client = self._client
        if client is None:
            raise WireDown(f"home_gripper: {self.fault}. Call resume()")
        permit.check()
        self._last, self._statuses = None, []
        self._motion = client.send(Command.HOMING)
        while self._is_in_motion:  # The caller cancels this wait at the time limit of the service.
            await trio.sleep(LOOK_S)
            self.read(self._clock.now_ns())
        if not self._statuses:
            raise WireDown(f"home_gripper: {self.fault}. Call resume()")
        return self._statuses[0]

    @property
    def _is_in_motion(self) -> bool:
        return self._motion is not None

    def begin_stop(self) -> int:
        """Stop a motion of the fingers at once. Return the time of the stop (ns). Never raises."""
        since_ns = self._clock.now_ns()
        if self._motion is not None and self._client is not None:
            try:
                self._stop = self._client.send(Command.STOP)
            except WireDown as down:
                self._lose(str(down))
        return since_ns

    async def confirm(self, since_ns: int) -> Outcome:
        """Wait until the fingers stand, and the motion that ran has ended. Never raises."""
        with trio.move_on_after(CONFIRM_S):
            while (client := self._client) is not None:
                self.read(self._clock.now_ns())
                if self._motion is None and self._stop is None and client.stands(since_ns):
                    return Outcome(True, True, "")
                await trio.sleep(LOOK_S)
        is_connected = self._client is not None
        return Outcome(is_connected, is_connected and self._stop is None, self.fault or "the fingers move")

    def _lose(self, reason: str) -> None:
        self.close()
        self._fault = reason

    def close(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client, self._motion, self._stop = None, None, None


async def keep_grip(host: str, clock: Clock) -> Outcome:
    """Stop fingers that move, on a separate connection, and keep the grip of all others. Never raises."""
    written = False
    client: HandClient | None = None
    try:
        client = await connect_hand(host, clock)
        stopped_ns = clock.now_ns()
        since_ns = stopped_ns + round(STANDS_S * NS)  # Fingers that move show it within this time.
        with trio.move_on_after(CONFIRM_S + STANDS_S):
            while not client.stands(since_ns):
                await trio.sleep(LOOK_S)
                client.look()
                if client.moved_since(stopped_ns):
                    client.send(Command.STOP)
                    written, stopped_ns = True, clock.now_ns() + round(STANDS_S * NS)
            return Outcome(True, True, "")
        return Outcome(written, bool(client.statuses), "the fingers move")
    except WireDown as down:
        return Outcome(written, False, str(down))
    finally:
        if client is not None:
            client.close_in_order()

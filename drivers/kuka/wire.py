"""Connect the wire process to a KUKA controller by FRI. It answers every cycle, and moves the arm while a
setpoint is valid."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.kit.session_wire import PromptSessionWire
from strands_actors.kernel.clock import NS, Clock

from .config import KeptPort, KukaConfig
from .link import Link, answer_instead, failed, first_message
from .protocol import JOINTS, Drive, Monitoring, State

SHORTEST_MS, LONGEST_MS = 2, 20
"""Limits of the cycle time. Python cannot answer every millisecond, and a hold must reach the arm within the
published bound."""
LOST_S = 0.5
"""The link counts as lost after this long without a message."""
ACTIVE_S = 3.0
"""Longest wait of an arming for a session that is about to accept commands."""


class KukaWire(PromptSessionWire[Link]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: KukaConfig, clock: Clock, kept: KeptPort | None = None) -> None:
        self._config = config
        self._kept = kept or KeptPort(config)
        self._clock = clock
        self._permit: Permit | None = None  # of the setpoint that moves the arm
        self._written_ns = 0  # when that setpoint was written or re-sent
        self._seen: Monitoring | None = None
        self._observation = Observation(0, (math.nan,) * JOINTS, (0,) * JOINTS)

    async def open(self) -> dict[str, Any]:
        """Wait for the first message of the controller. Nothing is sent."""
        self.close()
        config = self._config
        port = await self._kept.get()
        said: Monitoring | None = None
        with trio.move_on_after(config.connect_timeout_s):
            said = await first_message(port)
        if said is None:
            host, number = config.address()
            raise WireDown(
                f"open: no FRI message of {host or 'any controller'} at UDP port {number} within "
                f"{config.connect_timeout_s:g} s. Start the FRI session in the robot program, and check the "
                "address that it speaks to"
            )
        refuse_cycle(said)
        self.session_or_none = Link(port, config.arm, self._clock, said)
        return {"address": port.name, "sample_ms": said.sample_ms, "receive_multiplier": said.multiplier}

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Answer every cycle. Any answer keeps the session alive, whatever it contains."""
        link = self.session
        task_status.started()
        while True:
            said = await link.hear()
            refuse_cycle(said)
            if link.session.has_goal and not self._is_live():
                link.session.hold()
            link.answer(said)

    def _is_live(self) -> bool:
        """Whether the arm may still move: the setpoint is permitted, and was written or re-sent recently."""
        lifetime_ns = self._config.stream_ttl_s * NS
        if self._permit is None or self._clock.now_ns() - self._written_ns > lifetime_ns:
            return False
        try:
            self._permit.check()
        except PermitDenied:
            return False
        return True

    async def arm(self, permit: Permit) -> Observation:
        """Hold, and wait a while for a session that may soon accept commands.

        Nothing is energised: that is done on the pendant. A session without commands is armed all the same,
        and setpoints are refused until it accepts them.
        """
        link = self.session
        self._permit = None
        permit.check()
        with trio.move_on_after(ACTIVE_S):
            while link.said.state != State.COMMANDING_ACTIVE and _is_ready(link.said):
                await link.news.wait()
                permit.check()
        permit.check()
        return self._read(link)

    async def read(self) -> Observation:
        return self._read(self.session)

    def _read(self, link: Link) -> Observation:
        silent_s = link.silent_s()
        if silent_s > LOST_S:
            raise WireDown(f"read: no FRI message for {silent_s:.1f} s. Check the controller and the network")
        said = link.said
        if said is not self._seen:
            self._seen = said
            self._observation = observation_of(said, link.session.commanded, link.heard_ns)
        return self._observation

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Set a target. The next answers move towards it while the permit is valid."""
        link = self.session
        if link.said.state != State.COMMANDING_ACTIVE:
            raise PermitDenied(f"FRI session is {link.state}")
        permit.check()
        self._permit, self._written_ns = permit, self._clock.now_ns()
        link.session.aim(values[:JOINTS], values[JOINTS])

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        link = self.session_or_none
        if link is None:
            return failed(self._config.arm, "not connected")
        self._permit = None  # The next answers hold.

        async def cycle() -> None:
            await link.news.wait()  # ``serve`` sends the answer.

        return await link.bring_to_stand(cycle, "")

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Send one hold without a request, since a controller may receive without being received. Then answer
        any controller that sends."""
        arm, link = self._config.arm, self.session_or_none
        written = False
        try:
            if link is not None:
                self._permit = None
                written = link.hold_unasked()
            port = await self._kept.get()
            reports = await answer_instead(port, arm, self._clock, 0.0, "")
        except WireDown as down:
            return failed(arm, str(down), written)
        return reports or failed(arm, "the controller says nothing", written)

    def handover(self) -> tuple[int, ...]:
        return (self.session.port.fileno(),)

    def close(self) -> None:
        """Stop answering. The controller then drops the session and holds the arm."""
        self.session_or_none = self._permit = None


def refuse_cycle(said: Monitoring) -> None:
    """Raise ``WireDown`` if the cycle time is outside the limits."""
    cycle_ms = said.sample_ms * said.multiplier
    if said.sample_ms < SHORTEST_MS or not SHORTEST_MS <= cycle_ms <= LONGEST_MS:
        raise WireDown(
            f"FRI sample time {said.sample_ms} ms, receive multiplier {said.multiplier}. Set a sample time "
            f"of {SHORTEST_MS} ms or more in the robot program, and both together {LONGEST_MS} ms or less"
        )


def observation_of(said: Monitoring, commanded: tuple[float, ...], heard_ns: int) -> Observation:
    """Return a message as an observation. ``commanded`` is the position that we command; empty if we command
    nothing."""
    numbers = {
        "fri_state": said.state,
        "fri_quality": said.quality,
        "sample_time_s": said.sample_ms / 1e3,
        "safety_state": said.safety,
        "operation_mode": said.operation_mode,
        "control_mode": said.control_mode,
        "client_mode": said.client_mode,
        "overlay": said.overlay,
        "tracking": said.tracking,
    }
    sensors = {name: (float(number),) for name, number in numbers.items()}
    return Observation(
        t_ns=heard_ns,
        position=said.position,
        stamp_ns=(heard_ns,) * JOINTS,
        sensors={
            "torque_nm": said.torque,
            "external_torque_nm": said.external_torque,
            "commanded_rad": commanded or said.commanded,
            "drive_state": tuple(map(float, said.drives)),
            **sensors,
        },
    )


def _is_ready(said: Monitoring) -> bool:
    """Whether the session only needs time to accept commands, as far as the message shows."""
    return not said.safety and all(drive == Drive.ACTIVE for drive in said.drives)

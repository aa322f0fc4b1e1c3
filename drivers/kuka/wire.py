"""Connect the wire process (the only writer to the robot) to a KUKA controller by FRI.

It answers the controller in every cycle. While a setpoint is valid, the answers move the arm. Otherwise they hold
it.
"""

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
"""Limits of the time between two answers. A shorter time is too fast for Python. With a longer time a hold would
reach the arm later than the driver promises."""
LOST_S = 0.5
"""The connection counts as lost if no message arrives for this time."""
ACTIVE_S = 3.0
"""Longest time for which arming waits until the session accepts commands."""


class KukaWire(PromptSessionWire[Link]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: KukaConfig, clock: Clock, kept: KeptPort | None = None) -> None:
        self._config = config
        self._kept = kept or KeptPort(config)
        self._clock = clock
        self._permit: Permit | None = None  # Permission of the present setpoint. None: hold the arm.
        self._written_ns = 0  # Time at which the present setpoint was last written.
        self._last_message: Monitoring | None = None
        self._observation = Observation(0, (math.nan,) * JOINTS, (0,) * JOINTS)

    async def open(self) -> dict[str, Any]:
        """Open the UDP port and wait for the controller's first message. Nothing is sent yet."""
        self.close()
        config = self._config
        port = await self._kept.get()
        message: Monitoring | None = None
        with trio.move_on_after(config.connect_timeout_s):
            message = await first_message(port)
        if message is None:
            host, number = config.address()
            raise WireDown(
                f"open: no FRI message from {host or 'any controller'} at UDP port {number} within "
                f"{config.connect_timeout_s:g} s. Start the FRI session in the robot program, and check that it "
                "sends to the address of this computer"
            )
        refuse_cycle(message)
        self.session_or_none = Link(port, config.arm, self._clock, message)
        return {"address": port.name, "sample_ms": message.sample_ms, "receive_multiplier": message.multiplier}

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Answer the controller in every cycle, without end. Without answers the controller ends the session."""
        link = self.session
        task_status.started()
        while True:
            message = await link.receive()
            refuse_cycle(message)
            if link.session.has_goal and not self._is_live():
                link.session.hold()
            link.answer(message)

    def _is_live(self) -> bool:
        """Return True if the arm may move on: the setpoint is still permitted, and was written a short time ago."""
        lifetime_ns = self._config.stream_ttl_s * NS
        if self._permit is None or self._clock.now_ns() - self._written_ns > lifetime_ns:
            return False
        try:
            self._permit.check()
        except PermitDenied:
            return False
        return True

    async def arm(self, permit: Permit) -> Observation:
        """Hold the arm, and wait up to ``ACTIVE_S`` until the session accepts commands.

        Nothing is energised here, because the drives are switched on at the pendant. If the session does not accept
        commands in time, arming still succeeds, and setpoints are refused until it does.
        """
        link = self.session
        self._permit = None
        permit.check()
        with trio.move_on_after(ACTIVE_S):
            while link.message.state != State.COMMANDING_ACTIVE and _is_ready(link.message):
                await link.news.wait()
                permit.check()
        permit.check()
        return self._read(link)

    async def read(self) -> Observation:
        return self._read(self.session)

    def _read(self, link: Link) -> Observation:
        silent_s = link.silent_s()
        if silent_s > LOST_S:
            raise WireDown(
                f"read: the controller has sent no FRI message for {silent_s:.1f} s. "
                "Check the controller and the network"
            )
        message = link.message
        if message is not self._last_message:
            self._last_message = message
            self._observation = observation_of(message, link.session.commanded, link.last_received_ns)
        return self._observation

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Set a target. The next answers move the arm to it, as long as ``permit`` (the setpoint's permission) is
        valid."""
        link = self.session
        if link.message.state != State.COMMANDING_ACTIVE:
            raise PermitDenied(f"FRI session is {link.state}")
        permit.check()
        self._permit, self._written_ns = permit, self._clock.now_ns()
        link.session.aim(values[:JOINTS], values[JOINTS])

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        link = self.session_or_none
        if link is None:
            return failed(self._config.arm, "not connected")
        self._permit = None  # Without a permit, the next answers hold the arm.

        async def cycle() -> None:
            await link.news.wait()  # The task ``serve`` answers the message.

        return await link.bring_to_stand(cycle, "")

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the arm although its connection may be broken.

        First send one hold, because the controller may receive it even if its own messages do not arrive here. Then
        hold the arm by answers, if a controller sends messages.
        """
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
        return reports or failed(arm, "the controller sends no messages", written)

    def handover(self) -> tuple[int, ...]:
        return (self.session.port.fileno(),)

    def close(self) -> None:
        """Stop answering. The controller then ends the session and holds the arm."""
        self.session_or_none = self._permit = None


def refuse_cycle(message: Monitoring) -> None:
    """Raise ``WireDown`` if the controller's cycle is too short or too long for this driver."""
    cycle_ms = message.sample_ms * message.multiplier
    if message.sample_ms < SHORTEST_MS or not SHORTEST_MS <= cycle_ms <= LONGEST_MS:
        raise WireDown(
            f"FRI sample time {message.sample_ms} ms, receive multiplier {message.multiplier}. Set a sample time "
            f"of {SHORTEST_MS} ms or more in the robot program. Sample time times multiplier must be "
            f"{LONGEST_MS} ms or less"
        )


def observation_of(message: Monitoring, commanded: tuple[float, ...], received_ns: int) -> Observation:
    """Convert a message of the controller to an observation.

    ``commanded`` is the position in our last answer, or empty if it had no position.
    """
    numbers = {
        "fri_state": message.state,
        "fri_quality": message.quality,
        "sample_time_s": message.sample_ms / 1e3,
        "safety_state": message.safety,
        "operation_mode": message.operation_mode,
        "control_mode": message.control_mode,
        "client_mode": message.client_mode,
        "overlay": message.overlay,
        "tracking": message.tracking,
    }
    sensors = {name: (float(number),) for name, number in numbers.items()}
    return Observation(
        t_ns=received_ns,
        position=message.position,
        stamp_ns=(received_ns,) * JOINTS,
        sensors={
            "torque_nm": message.torque,
            "external_torque_nm": message.external_torque,
            "commanded_rad": commanded or message.commanded,
            "drive_state": tuple(map(float, message.drives)),
            **sensors,
        },
    )


def _is_ready(message: Monitoring) -> bool:
    """Return True if the robot could accept commands soon: no safety stop, and all drives active."""
    return not message.safety and all(drive == Drive.ACTIVE for drive in message.drives)

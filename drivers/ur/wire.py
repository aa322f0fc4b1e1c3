"""Connect the wire process (the only writer to the robot) to a UR controller.

It sends no setpoint while the controller's clock does not advance, because a frozen controller would carry it out
later.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import trio

from strands_actors.contract.loading import load
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, ProcessSpent, WireDown
from strands_actors.drivers.common.kit.hand import AXIS, Hand
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.drivers.common.kit.stamps import Stamps
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import plain
from .arms import GRIPPER_ID, IDS, JOINTS, URCAP
from .config import URConfig
from .control import Control, open_control
from .gates import CONTROL_S, PAUSED, START_S, WATCHDOG_HZ, refuse_modes
from .protocol import RuntimeState
from .stop_channel import STANDING_RAD_S, stop, stop_all

FEED_S = 0.025
"""Period of feeding the controller's watchdog, which stops the program after 100 ms."""

SILENT_S = 0.04
"""If the controller's clock has not advanced for this time (or for two samples), no setpoint is written. A frozen
controller would carry it out later."""

CONFIRM_S = 0.4

CLOCK_S = 1_000_000_000
"""A limit that the controller's clock (seconds since its start) never reaches, so the clock never wraps around. A
sample with an earlier time than the newest one is therefore old."""

SENSORS: Mapping[str, str] = {
    "current_a": "actual_current",
    "temperature_c": "joint_temperatures",
    "tcp_pose_m_rad": "actual_TCP_pose",
    "tcp_speed_m_s_rad_s": "actual_TCP_speed",
    "wrench_n_nm": "actual_TCP_force",  # Force and torque at the tool centre point, along the axes of the base.
    "robot_mode": "robot_mode",
    "safety_mode": "safety_mode",
    "runtime_state": "runtime_state",
}
"""Name of each sensor -> the output of the controller from which it is read."""
OUTPUTS = ("timestamp", "actual_q", "actual_qd", "speed_scaling", "target_speed_fraction", *SENSORS.values())


class URSession:
    """One connection to a controller: its samples, and a ``Control`` object that sends the commands."""

    def __init__(
        self,
        control: Control,
        samples: plain.Samples,
        config: URConfig,
        clock: Clock,
        gripper: Hand | None = None,
    ) -> None:
        self.control = control
        self.samples = samples
        self.gripper = gripper
        self.sample: dict[str, Any] = {}
        self._config = config
        self._clock = clock
        self._advanced = Stamps(CLOCK_S)  # The controller's time stamps, to detect that its clock has stopped.
        self._still_s = max(SILENT_S, 2 / config.samples_hz)
        self._fed_ns = 0
        self.controls = False  # True while our control script runs with an armed watchdog.
        self.servoing = False
        self.lost = ""  # The reason why the control script has ended since the robot was armed.

    def take(self, sample: dict[str, Any]) -> None:
        """Store a sample if it is newer than the last one.

        If the sample shows that the controller has stopped or paused our program, no setpoint is written until the
        robot is armed again. The motion must not start only because an operator unlocks the controller.
        """
        self.control.take()
        if not self._advanced.take(sample["timestamp"], self._clock.now_ns()):
            return
        self.sample = sample
        if self.controls:
            refusal = self.refuse_modes()
            if refusal is not None:
                self.lose(refusal.offered)
            elif self.runtime_state in PAUSED:
                self.lose("the control script was paused on the pendant")
            elif self.runtime_state != RuntimeState.PLAYING:
                self.lose("the controller has stopped the control script")

    def refuse_modes(self) -> Refused | None:
        return refuse_modes(self.sample["robot_mode"], self.sample["safety_mode"])

    @property
    def runtime_state(self) -> int:
        return int(self.sample["runtime_state"])

    def check_alive(self) -> None:
        """Raise ``WireDown`` if the controller's clock has not advanced for too long."""
        silent_s = self.silent_s()
        if silent_s > self._config.silent_s:
            raise WireDown(
                f"read: the clock of {self._config.robot} has not advanced for {silent_s * 1e3:.0f} ms. "
                "Check the controller and its network"
            )

    async def see_advance(self) -> None:
        """Wait for a sample that arrives after this call. It shows that the controller is not frozen.

        This check is needed before ur-rtde is opened: with a frozen controller its constructors never return.

        Raises:
            WireDown: No such sample has arrived.
        """
        requested_ns = self._clock.now_ns()
        with trio.move_on_after(plain.ANSWER_S):
            while True:
                await trio.sleep(CONTROL_S)
                if self._advanced.new_ns > requested_ns:
                    return
        raise WireDown("the controller's clock does not advance. Restart the controller")

    def lose(self, reason: str) -> None:
        self.lost, self.controls, self.servoing = reason, False, False

    def silent_s(self) -> float:
        return (self._clock.now_ns() - self._advanced.new_ns) / NS

    @property
    def is_still(self) -> bool:
        """True if the controller's clock has not advanced for so long that no setpoint may be written."""
        return self.silent_s() > self._still_s

    def stands_since(self, ordered_ns: int) -> bool:
        """Return True if a sample that arrived after ``ordered_ns`` shows that no joint moves."""
        fresh = self._advanced.new_ns > ordered_ns and not self.is_still
        return fresh and all(abs(rad_s) < STANDING_RAD_S for rad_s in self.sample["actual_qd"])

    def was_fed(self) -> None:
        self._fed_ns = self._clock.now_ns()

    async def feed(self) -> None:
        """Feed the controller's watchdog when this is due.

        During servo motion only the setpoints feed it. So the watchdog stops the arm if no more setpoints are
        accepted.
        """
        due = self._clock.now_ns() - self._fed_ns >= round(FEED_S * NS)
        if due and self.controls and not self.servoing:
            await self.control.kick()
            self.was_fed()

    def observation(self) -> Observation:
        sample = self.sample
        values = {name: sample[output] for name, output in SENSORS.items()}
        gripper = self.gripper
        faults = {"controller": self.lost} if self.lost else {}
        if gripper is not None and gripper.fault():
            faults[AXIS] = gripper.fault()
        return Observation(
            t_ns=self._clock.now_ns(),
            position=(*sample["actual_q"], *(() if gripper is None else (gripper.position,))),
            stamp_ns=(
                *(self._advanced.new_ns,) * len(JOINTS),
                *(() if gripper is None else (gripper.stamp_ns,)),
            ),
            velocity=(*sample["actual_qd"], *(() if gripper is None else (gripper.speed,))),
            sensors={
                **{name: value if isinstance(value, tuple) else (value,) for name, value in values.items()},
                # The controller's output speed_scaling does not include the speed slider, so multiply both.
                "speed_scaling": (sample["speed_scaling"] * sample["target_speed_fraction"],),
                "control": (float(self.controls),),
                "watchdog_hz": (WATCHDOG_HZ if self.controls else 0.0,),
                **({} if gripper is None else gripper.sensors()),
            },
            faults=faults,
        )


class URWire(SessionWire[URSession]):
    def __init__(self, config: URConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock

    async def open(self) -> dict[str, Any]:
        self.close()
        try:
            host = self._config.host
        except ValueError as error:
            raise WireDown(f"open: {error}") from None
        control = open_control(self._config, self._clock)
        facts = await plain.handshake(host)
        gripper: Hand | None = None
        if self._config.drives_gripper:
            gripper = await load(f"{URCAP}:open_gripper")(host, GRIPPER_ID, self._clock)
        try:
            samples = await plain.open_samples(host, OUTPUTS, self._config.samples_hz)
        except BaseException:
            if gripper is not None:
                gripper.close()
            raise
        session = self.session_or_none = URSession(control, samples, self._config, self._clock, gripper)
        try:
            session.take(await samples.first())
        except BaseException:
            self.close()
            raise
        return {"address": host, "host": host, "commanded_by": control.METHOD, **facts}

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Receive samples until cancelled, and store each one in the session."""
        session = self.session
        task_status.started()
        async with trio.open_nursery() as nursery:
            if session.gripper is not None:
                nursery.start_soon(session.gripper.serve)
            while True:
                session.take(await session.samples.next())

    async def arm(self, permit: Permit) -> Observation:
        session = self.session
        refusal = session.refuse_modes()
        if refusal is not None:
            raise WireDown(refusal.text)
        if session.runtime_state != RuntimeState.STOPPED:
            raise WireDown("another program runs on the controller. Call stop() to end it, then resume()")
        if (await plain.ask_dashboard(self._config.host, "is in remote control"))[0].lower() == "false":
            raise WireDown("the controller is in local control. Switch it to remote on the pendant")
        if session.gripper is not None:
            await session.gripper.arm(permit, self._config.activates_gripper)
        await session.see_advance()
        await session.control.connect()
        await self._start_script(session, permit)
        session.lost, session.controls, session.servoing = "", True, False
        return session.observation()

    async def read(self) -> Observation:
        session = self.session
        if session.control.spent:
            raise ProcessSpent(session.control.spent)
        await trio.lowlevel.checkpoint()
        session.check_alive()
        if session.gripper is not None:
            session.gripper.check_alive()
        return session.observation()

    async def feed(self) -> None:
        await self.session.feed()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        if not session.controls:
            raise PermitDenied(session.lost or "not armed")
        if session.is_still:
            raise PermitDenied("the controller's clock does not advance")
        session.servoing = await session.control.servo(values[: len(JOINTS)], permit.check)
        if not session.servoing:
            session.lose("the control script is not running")
        elif session.gripper is not None:
            permit.check()
            session.gripper.write(values[GRIPPER_ID:])

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return NOT_CONNECTED.reports(self._config.axes, self._config.ids)
        if session.gripper is None:
            return await self._stop_arm(session, safe_state)
        stopping = session.gripper.begin_stop()
        arm = await self._stop_arm(session, safe_state)
        gripper = await session.gripper.confirm(stopping)
        if not gripper.safe:
            gripper = await load(f"{URCAP}:stop_gripper")(self._config.host, GRIPPER_ID, self._clock)
        return (*arm, gripper)

    async def _stop_arm(self, session: URSession, safe_state: SafeState) -> tuple[MotorReport, ...]:
        ended = safe_state != SafeState.HOLD
        servoed = stands = False
        try:
            servoed = session.controls and await self._stop_by_control(session, ended)
            stands = (servoed or not ended) and await self._stands(session, ended)
        except (ProcessSpent, WireDown):
            pass  # The next ``read`` reports this error. The stop below works without the control script.
        if stands:
            rows = zip(JOINTS, IDS, session.sample["actual_q"], strict=True)
            return tuple(MotorReport(axis, motor, servoed, servoed, True, target=rad) for axis, motor, rad in rows)
        session.lose("stopped by the dashboard")
        return await stop(self._config)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the arm by the dashboard or a script port, which accept a stop at any time, and the gripper."""
        session = self.session_or_none
        if session is not None and session.gripper is not None:
            session.gripper.begin_stop()
        return await stop_all(self._config, self._clock)

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.control.close()
            self.session_or_none.samples.close()
            if self.session_or_none.gripper is not None:
                self.session_or_none.gripper.close()
        self.session_or_none = None

    # -- steps of arming and stopping

    async def _start_script(self, session: URSession, permit: Permit) -> None:
        """Upload the control script, wait until it runs, and arm its watchdog.

        Raises:
            WireDown: One of these steps has failed.
        """
        control = session.control
        if not await control.upload(permit.check):  # The permission is checked just before sending.
            raise WireDown("the controller does not accept the control script. Check the pendant, then try again")
        with trio.move_on_after(START_S):
            while not (session.runtime_state == RuntimeState.PLAYING and control.script_runs()):
                await trio.sleep(CONTROL_S)
                permit.check()
                session.check_alive()
        permit.check()
        if session.runtime_state != RuntimeState.PLAYING:
            raise WireDown(f"the control script did not start within {START_S:g} s. Check the pendant for errors")
        if not await control.set_watchdog(WATCHDOG_HZ):
            raise WireDown("the control script did not arm the controller's watchdog. Try again")
        session.was_fed()

    async def _stop_by_control(self, session: URSession, ended: bool) -> bool:
        """End the servo motion. If ``ended``, end the control script, too.

        While the arm brakes from a high speed, ur-rtde cannot feed the watchdog. So the controller's watchdog may
        end the script first.

        Returns:
            True if the script reports that the arm stands still.

        Raises:
            ProcessSpent: The SDK hangs.
            WireDown: The connection is lost.
        """
        session.servoing = False
        if ended:
            session.controls = False
        stopped = await session.control.halt(ended)
        session.was_fed()
        return stopped

    async def _stands(self, session: URSession, ended: bool) -> bool:
        """Return True if samples show that no joint moves and, if ``ended``, that no program runs.

        Raises:
            ProcessSpent: The SDK hangs.
            WireDown: The connection is lost.
        """
        ordered_ns = self._clock.now_ns()  # The stop was carried out before this time, because it was answered.
        with trio.move_on_after(CONFIRM_S):
            while True:
                await trio.sleep(CONTROL_S)
                await session.feed()
                if not session.stands_since(ordered_ns):
                    continue
                if not ended or session.runtime_state == RuntimeState.STOPPED:
                    return True
        return False

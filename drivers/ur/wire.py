"""A UR controller in the wire process: what is done with the SDK, and when it is not trusted."""

from __future__ import annotations

from typing import Any

import trio

from strands_actors.contract.wire import (
    MotorReport,
    Observation,
    Permit,
    PermitDenied,
    ProcessSpent,
    Wire,
    WireDown,
)
from strands_actors.kernel.clock import NS, Clock

from . import plain
from .arms import JOINTS
from .config import URConfig
from .gates import CONTROL_S, PAUSED, WATCHDOG_HZ, refuse_modes
from .protocol import RuntimeState
from .sdk import Sdk
from .stop_channel import STANDING_RAD_S, stop, unsafe

START_S = 3.0
"""From the upload of the control script until it runs."""

FEED_S = 0.025
"""Between kicks of a watchdog that waits 100 ms."""

SILENT_S = 0.04
"""Nothing is written to a controller whose clock stands still for so long: it would take it up
late."""

CONFIRM_S = 0.4


class _Session:
    """What exists between ``open`` and ``close``."""

    def __init__(self, sdk: Sdk, config: URConfig, clock: Clock) -> None:
        self.sdk = sdk
        self._config = config
        self._clock = clock
        self.sample = sdk.sample()
        self._stamp_ns = clock.now_ns()  # when the controller's clock was last seen to advance
        self._fed_ns = 0
        self.controls = False  # the control script is ours, runs, and its watchdog is armed
        self.servoing = False
        self.lost = ""  # why control was lost since the robot was armed

    def look(self) -> None:
        """Take the newest sample. A controller that stopped or paused our program is not written to again
        before the next arming: its operator unlocks it, and nothing may move because of that."""
        sample = self.sdk.sample()
        if sample.time_s != self.sample.time_s:
            self._stamp_ns = self._clock.now_ns()
        self.sample = sample
        if self.controls:
            refusal = refuse_modes(sample.robot_mode, sample.safety_mode)
            if refusal is not None:
                self.lose(refusal.offered)
            elif sample.runtime_state in PAUSED:
                self.lose("its program was paused on the pendant")
            elif sample.runtime_state != RuntimeState.PLAYING:
                self.lose("the controller stopped its program")

    def look_alive(self) -> None:
        """As ``look``. Raise ``WireDown`` when the controller's clock stands still."""
        self.look()
        silent_s = self.silent_s()
        if silent_s > self._config.silent_s:
            raise WireDown(
                f"read: the clock of {self._config.robot} stands still for {silent_s * 1e3:.0f} ms. "
                "Check the controller and its network"
            )

    def lose(self, why: str) -> None:
        self.lost, self.controls, self.servoing = why, False, False

    def silent_s(self) -> float:
        return (self._clock.now_ns() - self._stamp_ns) / NS

    def stands(self) -> bool:
        """Return whether a fresh sample shows that no joint moves."""
        return self.silent_s() < SILENT_S and all(abs(rad_s) < STANDING_RAD_S for rad_s in self.sample.velocity)

    def was_fed(self) -> None:
        self._fed_ns = self._clock.now_ns()

    async def feed(self) -> None:
        """Kick the controller's watchdog when it is due. While it servoes only setpoints feed it,
        and those are earned one by one."""
        due = self._clock.now_ns() - self._fed_ns >= round(FEED_S * NS)
        if due and self.controls and not self.servoing:
            await self.sdk.kick()
            self.was_fed()

    def observation(self) -> Observation:
        sample = self.sample
        return Observation(
            t_ns=self._clock.now_ns(),
            position=sample.position,
            stamp_ns=(self._stamp_ns,) * len(JOINTS),
            velocity=sample.velocity,
            sensors={
                "current_a": sample.current,
                "temperature_c": sample.temperature,
                "tcp_pose_m_rad": sample.pose,
                "tcp_speed_m_s_rad_s": sample.tcp_speed,
                "wrench_n_nm": sample.wrench,
                "robot_mode": (sample.robot_mode,),
                "safety_mode": (sample.safety_mode,),
                "runtime_state": (sample.runtime_state,),
                "speed_scaling": (sample.speed_scaling * sample.speed_slider,),
                "control": (float(self.controls),),
                "watchdog_hz": (WATCHDOG_HZ if self.controls else 0.0,),
            },
            faults={"controller": self.lost} if self.lost else {},
        )


class URWire(Wire):
    def __init__(self, config: URConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._session_or_none: _Session | None = None

    async def open(self) -> dict[str, Any]:
        """The plain ports first: against a controller that is frozen the SDK's constructors never
        return."""
        self.close()
        try:
            host = self._config.host
        except ValueError as error:
            raise WireDown(f"open: {error}") from None
        sdk = Sdk(host, self._config.rtde_hz)
        facts = await plain.handshake(host)
        await plain.look(host)
        await sdk.open_receive()
        self._session_or_none = _Session(sdk, self._config, self._clock)
        return {"address": host, "host": host, **facts}

    async def arm(self, permit: Permit) -> Observation:
        session, host = self._session(), self._config.host
        session.look()
        refusal = refuse_modes(session.sample.robot_mode, session.sample.safety_mode)
        if refusal is not None:
            raise WireDown(refusal.text.removeprefix("move: "))
        if session.sample.runtime_state != RuntimeState.STOPPED:
            raise WireDown("a program runs on the controller. stop() ends it, then resume()")
        if (await plain.ask_dashboard(host, "is in remote control"))[0].lower() == "false":
            raise WireDown("the controller is in local control. Switch it to remote on the pendant")
        await plain.look(host)
        permit.check()
        await session.sdk.open_control()
        permit.check()
        await self._start_script(session, permit)
        session.lost, session.controls, session.servoing = "", True, False
        return session.observation()

    async def read(self) -> Observation:
        session = self._session()
        if session.sdk.spent:
            raise ProcessSpent(session.sdk.spent)
        await trio.lowlevel.checkpoint()
        session.look_alive()
        return session.observation()

    async def feed(self) -> None:
        await self._session().feed()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self._session()
        session.look()
        if not session.controls:
            raise PermitDenied(session.lost or "not armed")
        if session.silent_s() > SILENT_S:
            raise PermitDenied("the controller's clock stands still")
        session.servoing = await session.sdk.servo(values, permit.check)
        if not session.servoing:
            session.lose("the control script is not running")

    async def make_safe(self, safe_state: str) -> tuple[MotorReport, ...]:
        session = self._session_or_none
        if session is None:
            return unsafe("not connected")
        ended = safe_state != "hold"
        servoed = stands = False
        try:
            servoed = session.controls and await self._stop_by_sdk(session, ended)
            stands = (servoed or not ended) and await self._stands(session, ended)
        except ProcessSpent:
            pass  # the next read says so
        if stands:
            rows = enumerate(zip(JOINTS, session.sample.position, strict=True))
            return tuple(MotorReport(joint, at, servoed, servoed, True, target=rad) for at, (joint, rad) in rows)
        session.lose("stopped without the SDK")
        return await stop(self._config)

    async def reach(self, safe_state: str) -> tuple[MotorReport, ...]:
        """The plain ports take a stop unasked."""
        return await stop(self._config)

    def close(self) -> None:
        """Nothing is closed: that takes the SDK half a second with the lock held, or for ever. What is open ends
        with this process, which cannot open another."""
        self._session_or_none = None

    # -- parts

    async def _start_script(self, session: _Session, permit: Permit) -> None:
        """Upload the control script, see it run, arm its watchdog. Raise ``WireDown``."""
        sdk = session.sdk
        if not await sdk.upload():
            raise WireDown("the controller does not take the control script. Try again")
        with trio.move_on_after(START_S):
            while not (session.sample.runtime_state == RuntimeState.PLAYING and sdk.script_runs()):
                await trio.sleep(CONTROL_S)
                permit.check()
                session.look_alive()
        permit.check()
        if session.sample.runtime_state != RuntimeState.PLAYING:
            raise WireDown(f"the control script does not start within {START_S:g} s. Look at the pendant")
        if not await sdk.set_watchdog(WATCHDOG_HZ):
            raise WireDown("the control script does not arm its watchdog. Try again")
        session.was_fed()

    async def _stop_by_sdk(self, session: _Session, ended: bool) -> bool:
        """Do servoStop, and for a stop end the script. Return whether the controller did it; from
        high speed its watchdog may end the program first, for nobody can feed it meanwhile. Raise
        ``ProcessSpent``."""
        session.servoing = False
        if ended:
            session.controls = False
        stopped = await session.sdk.servo_stop()
        if ended:
            await session.sdk.stop_script()
        session.was_fed()
        return stopped

    async def _stands(self, session: _Session, ended: bool) -> bool:
        """Return whether samples show that no joint moves, and for a stop that no program runs.
        Raise ``ProcessSpent``."""
        with trio.move_on_after(CONFIRM_S):
            while True:
                await trio.sleep(CONTROL_S)
                await session.feed()
                session.look()
                if session.stands() and (not ended or session.sample.runtime_state == RuntimeState.STOPPED):
                    return True
        return False

    def _session(self) -> _Session:
        if self._session_or_none is None:
            raise WireDown("wire: not connected. Open it first")
        return self._session_or_none

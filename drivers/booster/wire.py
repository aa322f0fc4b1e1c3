"""The wire of a T1, in the wire process.

A reading is made of the samples that have arrived. The robot keeps its last twist for ever. ``Twist``
therefore sends a zero when a twist is over, and repeats it until it is answered. The arms keep their
last goal, too. A target is sent again as long as it is in force.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import aclosing, suppress
from functools import partial
from typing import Any, ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.booster.refusals import BoosterCode
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.session_wire import PromptSessionWire
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from . import gates, rpc
from . import protocol as p
from .config import CONTROL_S, TWIST_S, BoosterConfig
from .link import FIND_S, Link, Order
from .protocol import Battery, Fall, Odometer
from .rpc import NEVER_WALKS, STANDS, WALKS, Api, Mode, Response
from .stopping import TICK_S, bring_down, unconfirmed

MODE_EVERY_S = 0.2
"""Period of asking for the mode, with or without an answer."""
MODE_WITH_ARMS_S = 0.05
"""The same period while the host has the arms. If the robot changes to custom mode, commands still leave
for this time and until the answer is there, and the legs let go by them. A robot that answers that it is
asked too often is asked at the slower rate."""
ANSWER_S = 0.5
"""Longest time for the answer to a request."""
EXTRAS_S = 1.0
"""Longest time for the slow topics at the start: fall state, battery."""
REACH_S = 0.6
"""Time for a robot that has to be stopped to discover our new participant."""
SILENT_S = 1.0
"""The link counts as lost after so long without a state or an answer."""


class Twist:
    """The present twist of the base, and the zero that ends it."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._until_ns = 0
        self._zero: Order | None = None

    def begin(self, until_ns: int) -> None:
        """Start a twist, which replaces the last one."""
        self._until_ns, self._zero = until_ns, None

    def forget(self) -> None:
        """Drop the twist, because a stop ends it in another way."""
        self._until_ns, self._zero = 0, None

    def end(self) -> None:
        self._until_ns, self._zero = 0, Order(self._link.calls, Api.MOVE, rpc.ZERO)

    def step(self, now_ns: int, mode: Mode | None) -> None:
        if 0 < self._until_ns <= now_ns:
            self.end()
        zero = self._zero
        if zero is None:
            return
        zero.step(now_ns)
        if zero.done or (zero.answer is not None and mode in NEVER_WALKS):
            self._zero = None


class GiveBack:
    """Hand back an upper body that the host may have without knowing it: a request for it was not
    answered in time, or the mode has become unknown."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._order: Order | None = None

    def begin(self) -> None:
        self._order = Order(self._link.calls, Api.UPPER_BODY, rpc.upper_body(False))

    def forget(self) -> None:
        """Drop the request, because the upper body is requested again."""
        self._order = None

    def step(self, now_ns: int, mode: Mode | None) -> None:
        order = self._order
        if order is None:
            return
        order.step(now_ns)
        # In a mode in which no controller keeps the robot up, there is nothing to hand back.
        if order.done or (order.answer is not None and mode is not None and mode not in STANDS):
            self._order = None


class BoosterSession:
    """The state between ``open`` and ``close``."""

    def __init__(self, config: BoosterConfig, clock: Clock) -> None:
        self.link = link = Link(config, clock)
        self.clock = clock
        self.twist = Twist(link)
        self.back = GiveBack(link)
        self.armed = False
        self.told = trio.Event()  # set by the next reading
        self.mode: Mode | None = None  # None if it is unknown
        self.ours: Mode | None = None  # the mode in which the upper body was handed over; None if it was not
        self.goal: tuple[float, ...] = ()  # last goal of the arms
        self.sensors: dict[str, tuple[float, ...]] = {}
        self._mode_ns = 0  # when the mode was asked for
        self._asked_ns = 0
        self._is_answered = False  # True if the last request for the mode was answered
        self._opened_ns = clock.now_ns()
        link.listen()
        link.follow("fall_down", p.FALL_TYPE, p.decode_fall, self._on_fall)
        link.follow("battery_state", p.BATTERY_TYPE, p.decode_battery, self._on_battery)
        link.follow("odometer_state", p.ODOMETER_TYPE, p.decode_odometer, self._on_odometer)

    def poll(self, now_ns: int) -> None:
        """Process the samples that have arrived, send due requests, and end an expired twist or mode."""
        self.link.poll()
        if self.mode is not None and now_ns - self._mode_ns > gates.MODE_TTL_S * NS:
            self.note_mode(None, now_ns)
        self.twist.step(now_ns, self.mode)
        self.back.step(now_ns, self.mode)
        every_s = MODE_WITH_ARMS_S if self.has_arms and self._is_answered else MODE_EVERY_S
        if now_ns - self._asked_ns >= every_s * NS:
            self._asked_ns, self._is_answered = now_ns, False
            self.link.calls.ask(Api.GET_MODE, "", partial(self.hear_mode, now_ns))

    def silent_s(self, now_ns: int) -> float:
        """Return the time since the newest state or the newest answer, whichever is older."""
        heard_ns = min(self.link.state_ns, self.link.calls.heard_ns or self._opened_ns)
        return (now_ns - heard_ns) / NS

    @property
    def has_arms(self) -> bool:
        return self.ours is not None

    def observation(self) -> Observation:
        link, count = self.link, len(self.link.model.joints)
        state, state_ns = link.state, link.state_ns
        sensors = {**self.sensors, "upper_body": (float(self.has_arms),)}
        if self.mode is not None:
            sensors["mode"] = float(self.mode), self._mode_ns / NS
        if state is None:
            return Observation(0, (math.nan,) * count, (0,) * count, sensors=sensors)
        sensors |= {
            "rpy_rad": state.rpy,
            "gyro_rad_s": state.gyro,
            "acceleration_m_s2": state.acceleration,
            "torque_nm": link.of_arms(state.tau),
            "temperature_c": tuple(map(float, link.of_arms(state.temperature))),
            "motors": (float(len(state.q)),),
        }
        if self.goal:
            sensors["goal_rad"] = self.goal
        return Observation(state_ns, link.of_arms(state.q), (state_ns,) * count, link.of_arms(state.dq), sensors)

    # -- received samples

    def hear_mode(self, asked_ns: int, response: Response) -> None:
        """Take the answer to a request for the mode. An answer without a readable mode makes the mode
        unknown. One that refuses the request as too frequent changes nothing."""
        if response.status == rpc.TOO_FREQUENT or asked_ns < self._mode_ns:
            return
        self._is_answered = True
        mode: Mode | None = None
        if response.status == rpc.OK:
            with suppress(MalformedFrame):
                mode = rpc.mode_of(response.body)
        self.note_mode(mode, asked_ns)

    def note_mode(self, mode: Mode | None, at_ns: int) -> None:
        self.mode, self._mode_ns = mode, at_ns
        if self.ours is not None and self.ours is not mode:
            self.ours = None  # Another mode returns the upper body to its former owner [assumed].
            self.back.begin()

    def _on_fall(self, sample: tuple[Fall, bool], t_ns: int) -> None:
        fall, recoverable = sample
        self.sensors["fall_state"] = float(fall), t_ns / NS
        self.sensors["recoverable"] = (float(recoverable),)

    def _on_battery(self, battery: Battery, t_ns: int) -> None:
        self.sensors["battery_pct"] = (battery.percent,)
        self.sensors["battery_soc_raw"] = (battery.soc,)
        self.sensors["battery_v"] = (battery.voltage,)
        self.sensors["battery_a"] = (battery.current,)

    def _on_odometer(self, odometer: Odometer, t_ns: int) -> None:
        self.sensors["odometry_xy_m"] = odometer.x_m, odometer.y_m
        self.sensors["odometry_heading_rad"] = (odometer.heading_rad,)


class BoosterWire(PromptSessionWire[BoosterSession]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: BoosterConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock

    # -- the link

    async def open(self) -> dict[str, Any]:
        """Connect to the robot, and wait for its state and its mode."""
        self.close()
        self.session_or_none = session = BoosterSession(self._config, self._clock)
        link, where = session.link, self._config.host
        await self._until(lambda: link.participant.peers > 0, f"{where}: nobody answers. Check port=")
        await self._until(lambda: link.commands.matched > 0, f"{where}: nobody there takes commands of a T1")
        await self._until(lambda: link.calls.matched, f"{where}: its service does not answer. Check domain_id=")
        await self._until(lambda: session.mode is not None, f"{where}: its mode cannot be read")
        await self._until(lambda: link.state is not None, f"{where}: no LowState comes")
        await self._look(lambda: {"fall_state", "battery_pct"} <= session.sensors.keys(), EXTRAS_S)
        assert link.state is not None and session.mode is not None
        return {"address": where, "motors": len(link.state.q), "mode": session.mode.name.lower()}

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """End each twist in time, beside all other calls."""
        task_status.started()
        async with aclosing(self._clock.ticks(CONTROL_S)) as ticks:
            async for now_ns in ticks:
                self.session.poll(now_ns)

    async def read(self) -> Observation:
        session, now_ns = self.session, self._clock.now_ns()
        session.poll(now_ns)
        silent_s = session.silent_s(now_ns)
        if silent_s > SILENT_S:
            raise WireDown(f"read: no state, or no answer, for {silent_s:.1f} s. Check the robot and the network")
        session.told.set()
        return session.observation()

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.link.close()
            self.session_or_none = None

    # -- commanding

    async def arm(self, permit: Permit) -> Observation:
        """Check that the robot may be moved. Nothing is energised: its own controller keeps it up."""
        session = self.session
        observation = await self.read()
        now_ns = self._clock.now_ns()
        refusal = self._unfit(observation) or gates.mode_known(observation, now_ns)
        refusal = refusal or gates.not_custom(observation, now_ns)
        if refusal is not None:
            raise WireDown(f"arm: {refusal.text}")
        await trio.lowlevel.checkpoint()
        permit.check()
        session.armed = True
        return await self.read()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        if not (session.armed and session.has_arms):
            raise PermitDenied("the upper body is not ours")
        permit.check()
        session.goal = values[: len(self._config.model.joints)]
        if not session.link.send_target(values):
            raise WireDown("write: the robot no longer takes commands. Check the robot and the network")

    # -- safe

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return unconfirmed(self._config.model, "not connected")
        has_arms = session.has_arms
        session.twist.forget()
        session.goal = ()
        if safe_state != SafeState.HOLD:
            session.armed, session.ours = False, None
        motors = await bring_down(session.link, safe_state, has_arms)
        if safe_state == SafeState.HOLD and all(motor.target is not None for motor in motors):
            session.goal = tuple(motor.target for motor in motors if motor.target is not None)
        return motors

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop by the existing participant, which the robot discovers again by itself; otherwise by a
        new one, which has to be discovered first."""
        session = self.session_or_none
        if session is not None:
            session.twist.forget()
            session.armed, session.ours = False, None
            return await bring_down(session.link, safe_state)
        try:
            link = Link(self._config, self._clock)
        except WireDown as down:
            return unconfirmed(self._config.model, str(down))
        try:
            link.listen()
            with trio.move_on_after(REACH_S):
                while not link.heard:
                    link.poll()
                    await trio.sleep(TICK_S)
            return await bring_down(link, safe_state)
        finally:
            link.close()

    # -- services

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        session = self.session
        if not session.armed:
            return Refused(Code.DISARMED, "the robot was stopped", "call resume() first")
        match service:
            case "move":
                return await self._walk(session, arguments, permit)
            case "rotate_head":
                pitch, yaw = (float(arguments.get(name, 0.0)) for name in ("pitch", "yaw"))
                answer = await self._ask(session, Api.ROTATE_HEAD, rpc.rotate_head(pitch, yaw), permit)
                return _refused(service, answer) or {"pitch": pitch, "yaw": yaw}
            case "change_mode":
                return await self._change_mode(session, gates.MODES[arguments["mode"]], permit)
            case "enable_upper_body" if arguments.get("on", True):
                return await self._take_arms(session, permit)
            case _:
                return await self._give_arms(session, permit)

    async def _walk(
        self, session: BoosterSession, arguments: Mapping[str, Any], permit: Permit
    ) -> dict[str, Any] | Refused:
        if session.mode not in WALKS:  # The known mode may be a moment old.
            await self._look_at_mode(session, permit)
        refusal = gates.move_refusal(session.mode) or self._unfit(await self.read())
        if refusal is not None:
            return refusal
        vx, vy, vyaw = (float(arguments.get(name, 0.0)) for name in ("vx", "vy", "vyaw"))
        permit.check()
        session.twist.begin(self._clock.now_ns() + round(TWIST_S * NS))
        answer = await self._ask(session, Api.MOVE, rpc.move(vx, vy, vyaw), permit)
        # Set the end of the twist for any answer, because after a refusal, too, the robot may walk, now or later.
        return _refused("move", answer) or {"vx": vx, "vy": vy, "vyaw": vyaw, "for_s": TWIST_S}

    async def _change_mode(self, session: BoosterSession, mode: Mode, permit: Permit) -> dict[str, Any] | Refused:
        permit.check()
        had_arms, asked_ns = session.has_arms, self._clock.now_ns()
        session.ours, changed = None, False
        try:
            answer = await self._ask(session, Api.CHANGE_MODE, rpc.change_mode(mode), permit)
            refusal = _refused("change_mode", answer)
            changed = refusal is None
        finally:
            if had_arms and not changed:
                session.back.begin()  # The robot is still in the mode in which it handed them over.
        if changed:
            session.note_mode(mode, asked_ns)
        return refusal or {"mode": mode.name.lower()}

    async def _take_arms(self, session: BoosterSession, permit: Permit) -> dict[str, Any] | Refused:
        await self._look_at_mode(session, permit)
        observation = await self.read()
        refusal = gates.handover_refusal(session.mode, STANDS) or self._unfit(observation)
        if refusal is not None:
            return refusal
        permit.check()
        mode = session.mode
        session.ours, session.goal = None, ()
        session.back.forget()
        try:
            answer = await self._ask(session, Api.UPPER_BODY, rpc.upper_body(True), permit)
            refusal = _refused("enable_upper_body", answer)
            if refusal is None and session.mode is not mode:
                refusal = gates.handover_refusal(session.mode, (mode,) if mode else ())
            if refusal is None:
                session.ours = mode
        finally:
            if not session.has_arms:
                session.back.begin()  # A hold came, or no answer. It may still hand them over.
        if refusal is not None:
            return refusal
        await self._told(session)
        return {"upper_body": True}

    async def _give_arms(self, session: BoosterSession, permit: Permit) -> dict[str, Any] | Refused:
        permit.check()
        session.ours, session.goal = None, ()
        answer: Response | None = None
        try:
            answer = await self._ask(session, Api.UPPER_BODY, rpc.upper_body(False), permit)
        finally:
            if answer is None or answer.why:
                session.back.begin()
        await self._told(session)
        return _refused("disable_upper_body", answer) or {"upper_body": False}

    async def _told(self, session: BoosterSession) -> None:
        """Wait for the next reading, so that the gate sees the change before the caller gets its reply."""
        session.told = told = trio.Event()
        await told.wait()

    # -- parts

    def _unfit(self, observation: Observation) -> Refused | None:
        return gates.not_ready(observation, self._clock.now_ns(), gates.FALL_TTL_S)

    async def _look_at_mode(self, session: BoosterSession, permit: Permit) -> None:
        asked_ns = self._clock.now_ns()
        answer = await self._ask(session, Api.GET_MODE, "", permit)
        if answer is not None:
            session.hear_mode(asked_ns, answer)

    async def _ask(self, session: BoosterSession, api: Api, body: str, permit: Permit) -> Response | None:
        """Send a request and return its response; None without one in ``ANSWER_S``."""
        responses: list[Response] = []
        permit.check()
        session.link.calls.ask(api, body, responses.append)
        with trio.move_on_after(ANSWER_S):
            while not responses:
                session.poll(self._clock.now_ns())
                await trio.sleep(TICK_S)
        return responses[0] if responses else None

    async def _until(self, condition: Callable[[], bool], otherwise: str) -> None:
        if not await self._look(condition, FIND_S):
            raise WireDown(otherwise)

    async def _look(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Process what arrives until the condition is true. Return False after ``within_s`` seconds."""
        session = self.session
        with trio.move_on_after(within_s):
            while not condition():
                session.poll(self._clock.now_ns())
                await trio.sleep(TICK_S)
            return True
        return False


def _refused(service: str, answer: Response | None) -> Refused | None:
    """Return the refusal for an answer; None if the service was carried out."""
    if answer is None:
        why = "the robot has not answered; it may do so yet"
        return Refused(BoosterCode.NOT_CONFIRMED, why, "look at the robot", "no answer", f"within {ANSWER_S:g} s")
    if answer.why:
        return Refused(
            BoosterCode.STATUS, f"the robot says {answer.why}", "look at the robot", str(answer.status), "0"
        )
    return None

"""Drive a T1. This module runs in the wire process, the only process that writes commands to the
robot.

A reading consists of the newest received samples. The robot keeps its last twist for ever.
``Twist`` therefore sends a zero when the duration of a twist ends, and repeats it until the robot
answers. The arms keep their last goal, too. A target is repeated as long as it is in force.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import aclosing, suppress
from functools import partial
from typing import Any, ClassVar

import trio

from strands_actors.contract.refusals import robot_stopped
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.session_wire import PromptSessionWire
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from . import gates, refusals, rpc
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
    """The present twist of the base. When its duration ends, it sends a zero twist until the robot
    answers."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._until_ns = 0
        self._zero: Order | None = None

    def begin(self, until_ns: int) -> None:
        """Start a twist. It replaces the previous twist."""
        self._until_ns, self._zero = until_ns, None

    def forget(self) -> None:
        """Forget the twist and send no zero for it, because a stop now makes the robot stand."""
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
    """Give the upper body back to the robot after an unclear result: the robot did not answer the
    request in time, or its mode is unknown. The host may then have the upper body although it seems
    not to."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._order: Order | None = None

    def begin(self) -> None:
        self._order = Order(self._link.calls, Api.UPPER_BODY, rpc.upper_body(False))

    def forget(self) -> None:
        """Cancel giving back the upper body, because the host requests it again."""
        self._order = None

    def step(self, now_ns: int, mode: Mode | None) -> None:
        order = self._order
        if order is None:
            return
        order.step(now_ns)
        # In a mode in which no controller balances the robot, there is no controller to give the upper body back
        # to.
        if order.done or (order.answer is not None and mode is not None and mode not in STANDS):
            self._order = None


class BoosterSession:
    """The connection to the robot and its state, from ``open`` to ``close``."""

    def __init__(self, config: BoosterConfig, clock: Clock) -> None:
        self.link = link = Link(config, clock)
        self.clock = clock
        self.twist = Twist(link)
        self.back = GiveBack(link)
        self.armed = False
        self.next_reading = trio.Event()  # set when the next reading is made
        self.mode: Mode | None = None  # None if it is unknown
        # The mode in which the robot gave the upper body to the host; None if the host does not have it.
        self.handover_mode: Mode | None = None
        self.goal: tuple[float, ...] = ()  # last goal of the arms
        self.sensors: dict[str, tuple[float, ...]] = {}
        self._mode_ns = 0  # when the mode was last requested
        self._requested_ns = 0
        self._is_answered = False  # True if the last request for the mode was answered
        self._opened_ns = clock.now_ns()
        link.listen()
        link.follow("fall_down", p.FALL_TYPE, p.decode_fall, self._on_fall)
        link.follow("battery_state", p.BATTERY_TYPE, p.decode_battery, self._on_battery)
        link.follow("odometer_state", p.ODOMETER_TYPE, p.decode_odometer, self._on_odometer)

    def poll(self, now_ns: int) -> None:
        """Process the received messages, send the requests that are due, and end a twist or a mode
        report that has expired."""
        self.link.poll()
        if self.mode is not None and now_ns - self._mode_ns > gates.MODE_TTL_S * NS:
            self.note_mode(None, now_ns)
        self.twist.step(now_ns, self.mode)
        self.back.step(now_ns, self.mode)
        every_s = MODE_WITH_ARMS_S if self.has_arms and self._is_answered else MODE_EVERY_S
        if now_ns - self._requested_ns >= every_s * NS:
            self._requested_ns, self._is_answered = now_ns, False
            self.link.calls.ask(Api.GET_MODE, "", partial(self.hear_mode, now_ns))

    def silent_s(self, now_ns: int) -> float:
        """Return for how many seconds the robot has been silent: the age of the newest state or of
        the newest answer, whichever is greater."""
        last_received_ns = min(self.link.state_ns, self.link.calls.last_answer_ns or self._opened_ns)
        return (now_ns - last_received_ns) / NS

    @property
    def has_arms(self) -> bool:
        return self.handover_mode is not None

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

    def hear_mode(self, requested_ns: int, response: Response) -> None:
        """Process the answer to a request for the mode. An answer without a readable mode makes the
        mode unknown. The answer "too frequent" changes nothing."""
        if response.status == rpc.TOO_FREQUENT or requested_ns < self._mode_ns:
            return
        self._is_answered = True
        mode: Mode | None = None
        if response.status == rpc.OK:
            with suppress(MalformedFrame):
                mode = rpc.mode_of(response.body)
        self.note_mode(mode, requested_ns)

    def note_mode(self, mode: Mode | None, at_ns: int) -> None:
        self.mode, self._mode_ns = mode, at_ns
        if self.handover_mode is not None and self.handover_mode is not mode:
            # A change of the mode ends the host's control of the upper body [assumed].
            self.handover_mode = None
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
        link, address = session.link, self._config.host
        await self._until(lambda: link.participant.peers > 0, f"{address}: no robot answers. Check port=")
        await self._until(lambda: link.commands.matched > 0, f"{address}: no T1 receives commands there")
        await self._until(
            lambda: link.calls.matched, f"{address}: the robot's service does not answer. Check domain_id="
        )
        await self._until(lambda: session.mode is not None, f"{address}: the robot does not report the mode")
        await self._until(lambda: link.state is not None, f"{address}: no state arrives (topic LowState)")
        await self._look(lambda: {"fall_state", "battery_pct"} <= session.sensors.keys(), EXTRAS_S)
        assert link.state is not None and session.mode is not None
        return {"address": address, "motors": len(link.state.q), "mode": session.mode.name.lower()}

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Process messages and end twists on time, in parallel with the other calls."""
        task_status.started()
        async with aclosing(self._clock.ticks(CONTROL_S)) as ticks:
            async for now_ns in ticks:
                self.session.poll(now_ns)

    async def read(self) -> Observation:
        session, now_ns = self.session, self._clock.now_ns()
        session.poll(now_ns)
        silent_s = session.silent_s(now_ns)
        if silent_s > SILENT_S:
            raise WireDown(
                f"read: no state, or no answer to a request, for {silent_s:.1f} s. Check the robot and the network"
            )
        session.next_reading.set()
        return session.observation()

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.link.close()
            self.session_or_none = None

    # -- commanding

    async def arm(self, permit: Permit) -> Observation:
        """Check that the robot may be moved. Arming energises nothing: the robot's own controller
        keeps it standing."""
        session = self.session
        observation = await self.read()
        now_ns = self._clock.now_ns()
        refusal = self._unfit(observation) or gates.mode_reported(observation, now_ns)
        refusal = refusal or gates.not_custom(observation, now_ns)
        if refusal is not None:
            raise WireDown(f"arming: {refusal.text}")
        await trio.lowlevel.checkpoint()
        permit.check()
        session.armed = True
        return await self.read()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session = self.session
        if not (session.armed and session.has_arms):
            raise PermitDenied("the host does not have the upper body")
        permit.check()
        session.goal = values[: len(self._config.model.joints)]
        if not session.link.send_target(values):
            raise WireDown("write: the robot no longer receives commands. Check the robot and the network")

    # -- safe

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return unconfirmed(self._config.model, "not connected")
        has_arms = session.has_arms
        session.twist.forget()
        session.goal = ()
        if safe_state != SafeState.HOLD:
            session.armed, session.handover_mode = False, None
        motors = await bring_down(session.link, safe_state, has_arms)
        if safe_state == SafeState.HOLD and all(motor.target is not None for motor in motors):
            session.goal = tuple(motor.target for motor in motors if motor.target is not None)
        return motors

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the robot after its link was lost. Use the existing DDS participant, which the robot
        discovers again by itself. Without one, create a participant, which the robot must discover
        first."""
        session = self.session_or_none
        if session is not None:
            session.twist.forget()
            session.armed, session.handover_mode = False, None
            return await bring_down(session.link, safe_state)
        try:
            link = Link(self._config, self._clock)
        except WireDown as down:
            return unconfirmed(self._config.model, str(down))
        try:
            link.listen()
            with trio.move_on_after(REACH_S):
                while not link.matched:
                    link.poll()
                    await trio.sleep(TICK_S)
            return await bring_down(link, safe_state)
        finally:
            link.close()

    # -- services

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        session = self.session
        if not session.armed:
            return robot_stopped()
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
        # The stored mode may be out of date, so ask the robot again.
        if session.mode not in WALKS:
            await self._look_at_mode(session, permit)
        refusal = gates.move_refusal(session.mode) or self._unfit(await self.read())
        if refusal is not None:
            return refusal
        vx, vy, vyaw = (float(arguments.get(name, 0.0)) for name in ("vx", "vy", "vyaw"))
        permit.check()
        session.twist.begin(self._clock.now_ns() + round(TWIST_S * NS))
        answer = await self._ask(session, Api.MOVE, rpc.move(vx, vy, vyaw), permit)
        # Keep the end time of the twist, also after a refusal, because the robot may walk all the same.
        return _refused("move", answer) or {"vx": vx, "vy": vy, "vyaw": vyaw, "for_s": TWIST_S}

    async def _change_mode(self, session: BoosterSession, mode: Mode, permit: Permit) -> dict[str, Any] | Refused:
        permit.check()
        had_arms, requested_ns = session.has_arms, self._clock.now_ns()
        session.handover_mode, changed = None, False
        try:
            answer = await self._ask(session, Api.CHANGE_MODE, rpc.change_mode(mode), permit)
            refusal = _refused("change_mode", answer)
            changed = refusal is None
        finally:
            if had_arms and not changed:
                # The robot may still be in the mode in which the host has the arms. Give them back.
                session.back.begin()
        if changed:
            session.note_mode(mode, requested_ns)
        return refusal or {"mode": mode.name.lower()}

    async def _take_arms(self, session: BoosterSession, permit: Permit) -> dict[str, Any] | Refused:
        await self._look_at_mode(session, permit)
        observation = await self.read()
        refusal = gates.handover_refusal(session.mode, STANDS) or self._unfit(observation)
        if refusal is not None:
            return refusal
        permit.check()
        mode = session.mode
        session.handover_mode, session.goal = None, ()
        session.back.forget()
        try:
            answer = await self._ask(session, Api.UPPER_BODY, rpc.upper_body(True), permit)
            refusal = _refused("enable_upper_body", answer)
            if refusal is None and session.mode is not mode:
                refusal = gates.handover_refusal(session.mode, (mode,) if mode else ())
            if refusal is None:
                session.handover_mode = mode
        finally:
            if not session.has_arms:
                # A stop ended the request, or the robot did not answer and may still hand over the arms. Give
                # them back.
                session.back.begin()
        if refusal is not None:
            return refusal
        await self._wait_for_reading(session)
        return {"upper_body": True}

    async def _give_arms(self, session: BoosterSession, permit: Permit) -> dict[str, Any] | Refused:
        permit.check()
        session.handover_mode, session.goal = None, ()
        answer: Response | None = None
        try:
            answer = await self._ask(session, Api.UPPER_BODY, rpc.upper_body(False), permit)
        finally:
            if answer is None or answer.error:
                session.back.begin()
        await self._wait_for_reading(session)
        return _refused("disable_upper_body", answer) or {"upper_body": False}

    async def _wait_for_reading(self, session: BoosterSession) -> None:
        """Wait for the next reading of the robot. The checks of commands (gates) then know the
        effect of a service before the caller gets the reply of the service."""
        session.next_reading = next_reading = trio.Event()
        await next_reading.wait()

    # -- parts

    def _unfit(self, observation: Observation) -> Refused | None:
        return gates.not_ready(observation, self._clock.now_ns(), gates.FALL_TTL_S)

    async def _look_at_mode(self, session: BoosterSession, permit: Permit) -> None:
        requested_ns = self._clock.now_ns()
        answer = await self._ask(session, Api.GET_MODE, "", permit)
        if answer is not None:
            session.hear_mode(requested_ns, answer)

    async def _ask(self, session: BoosterSession, api: Api, body: str, permit: Permit) -> Response | None:
        """Send a request and return the response; None if it does not arrive within ``ANSWER_S``
        seconds."""
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
        """Process received messages until the condition is true. Return False after ``within_s``
        seconds."""
        session = self.session
        with trio.move_on_after(within_s):
            while not condition():
                session.poll(self._clock.now_ns())
                await trio.sleep(TICK_S)
            return True
        return False


def _refused(service: str, answer: Response | None) -> Refused | None:
    """Turn the robot's answer into a refusal; None if the service was carried out."""
    if answer is None:
        return refusals.unconfirmed_request(ANSWER_S)
    if answer.error:
        return refusals.failed_request(answer.error, answer.status)
    return None

"""Connect the wire process (the only writer to the robot) to an arm of CAN motors, and command its joints.

The motors keep their last command, and switch their torque off ``TIMEOUT_S`` after it. So while the arm
holds, ``feed`` repeats the hold, and it is called only while the processes of the robot work.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import aclosing
from typing import Any, ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.kinematics.chain import Chain
from strands_actors.drivers.common.kit.motor_targets import ROWS
from strands_actors.drivers.common.kit.session_wire import PromptSessionWire
from strands_actors.drivers.common.ports.serial_port import open_serial
from strands_actors.drivers.common.servo.lowering import RestPath
from strands_actors.kernel.clock import NS, Clock

from .can_port import OpenPort
from .config import CanConfig
from .link import Addressed, Link, failed
from .protocol import TICKS_PER_S, Command, Ranges, State
from .stopping import PERIOD_S, TIMEOUT_S, bring_down

ANSWER_S = 0.03
"""A motor that has not answered after this time is asked again."""
ATTEMPTS = 8
IDLE_S = 0.02
"""After this time without a command, and after two control periods at least, the motors are asked."""
LOST_S = 0.3
"""If no motor at all is heard for this time, the connection counts as lost."""
OUTSIDE_RAD = 0.09
"""A joint may be so far outside its range when it is energised."""
NEAR_RAD = 0.15
"""A hold keeps the last target if the joint is so near to it, so that the arm does not sag. A joint that is farther
away is blocked, and is held where it is."""
HOLD_S = 0.05
"""Longest time until all motors have confirmed a hold."""
GRAVITY_S = 0.02
"""Period in which the weight of the arm is computed anew."""
BLOCKED_RAD = 0.5
"""While the arm is lowered, a joint that is so far from its goal has met something."""


class CanSession:
    """The state of one connection, from ``open`` to ``close``."""

    def __init__(self, config: CanConfig, link: Link, clock: Clock) -> None:
        motors = config.arm.motors
        self.link = link
        self.clock = clock
        self.target: list[float] = []  # the last target of each joint; empty while the arm is not armed
        self.holds = False
        self.sent_ns = 0
        self._gains = [(motor.kp, motor.kd) for motor in motors]
        self._model = Chain(config.model, [motor.key for motor in motors]) if config.gravity else None
        self._weight, self._weighed_ns = [0.0] * len(motors), 0

    def weight(self) -> list[float]:
        """Return the torque of each joint that carries the arm; 0 without compensation."""
        now_ns = self.clock.now_ns()
        if self._model is not None and now_ns - self._weighed_ns >= GRAVITY_S * NS:
            self._weighed_ns = now_ns
            torques = self._model.gravity_nm([feedback.position for feedback in self.link.feedback])
            limits = (motor.torque for motor in self.link.motors)
            self._weight = [max(-most, min(most, nm)) for nm, most in zip(torques, limits, strict=True)]
        return self._weight

    def hold_frames(self, goals: Sequence[float]) -> list[Addressed]:
        return self.link.command(
            Command(q, 0.0, tau, kp, kd, hold=True)
            for q, tau, (kp, kd) in zip(goals, self.weight(), self._gains, strict=True)
        )

    def hold(self, goals: Sequence[float]) -> dict[int, str]:
        """Send a hold, and let ``feed`` repeat it. Return why it was not sent, by motor."""
        self.target, self.holds = list(goals), True
        self.sent_ns = self.clock.now_ns()
        return self.link.send_stop(self.hold_frames(goals))

    def present_goals(self) -> list[float]:
        """Return where to hold each joint: at its target if it is near, else at its position."""
        positions = [feedback.position for feedback in self.link.feedback]
        targets = self.target or positions
        return [
            target if abs(target - position) <= NEAR_RAD else position
            for target, position in zip(targets, positions, strict=True)
        ]

    def observation(self) -> Observation:
        link, feedback = self.link, self.link.feedback
        quiet = self.clock.now_ns() - round(LOST_S * NS)
        faults = {
            motor.key: "silent" if stamp_ns < quiet else reading.state.name.lower().replace("_", " ")
            for motor, reading, stamp_ns in zip(link.motors, feedback, link.stamp_ns, strict=True)
            if stamp_ns < quiet or reading.state > State.ENABLED
        }
        return Observation(
            t_ns=max(link.stamp_ns),
            position=tuple(reading.position for reading in feedback),
            stamp_ns=tuple(link.stamp_ns),
            velocity=tuple(reading.velocity for reading in feedback),
            sensors={
                "torque_nm": tuple(reading.torque for reading in feedback),
                "driver_temperature_c": tuple(reading.driver_c for reading in feedback),
                "rotor_temperature_c": tuple(reading.rotor_c for reading in feedback),
                "motor_state": tuple(float(reading.state) for reading in feedback),
                "armed": (float(bool(self.target)),),
            },
            faults=faults,
        )


class CanWire(PromptSessionWire[CanSession]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: CanConfig, clock: Clock, open_port: OpenPort = open_serial) -> None:
        self._config = config
        self._clock = clock
        self._open_port = open_port
        self._count = len(config.arm.motors)
        self._lowering = False

    @property
    def seen(self) -> Observation | None:
        session = self.session_or_none
        return session.observation() if session is not None and self._lowering else None

    async def open(self) -> dict[str, Any]:
        """Open the buses, and find every motor. Nothing is energised or configured."""
        self.close()
        link = Link.open(self._config, self._clock, self._open_port)
        self.session_or_none = CanSession(self._config, link, self._clock)
        try:
            missing = await self._read_ranges(link)
            began_ns = self._clock.now_ns()
            missing = missing or await self._exchange(
                link,
                lambda index: [link.codecs[index].ask()],
                lambda index: link.stamp_ns[index] > began_ns,
            )
            if missing:
                raise WireDown(
                    f"open: no answer from {link.names(missing)} at {', '.join(self._config.ports)}. Check the "
                    "power, the wires and the ids of the motors, and that the bus runs at 1 Mbit/s"
                )
        except BaseException:
            self.close()
            raise
        return {"buses": list(self._config.ports), "adapters": list(self._config.adapters)}

    async def _read_ranges(self, link: Link) -> list[int]:
        """Use the ranges that the motors report, because a motor may have been configured with other ones.

        Return the motors that have not answered.
        """
        numbers = [codec.RANGES for codec in link.codecs]
        if unread := await self._read_parameters(link, numbers):
            return unread
        for index, (motor, own) in enumerate(zip(link.motors, numbers, strict=True)):
            if own:
                reported = (link.parameters[index, number].real for number in own)
                usual = motor.type.ranges
                position, velocity, torque = reported
                link.codecs[index] = motor.codec(Ranges(position, velocity, torque, usual.kp, usual.kd))
        return []

    async def arm(self, permit: Permit) -> Observation:
        """Set up and energise motor after motor, each held at its measured position."""
        session = self.session
        link = session.link
        session.target = []
        await self._set_up(link)
        for motor, feedback in zip(link.motors, link.feedback, strict=True):
            if not motor.low - OUTSIDE_RAD <= feedback.position <= motor.high + OUTSIDE_RAD:
                raise WireDown(
                    f"enable: {motor.key} is at {feedback.position:.2f} rad, outside {motor.low:g}..{motor.high:g}."
                    " Move it into its range by hand, then call resume()"
                )
        goals = [feedback.position for feedback in link.feedback]
        holds = session.hold_frames(goals)
        for index, codec in enumerate(link.codecs):
            # The motors that have torque already get their hold again, before their timeout ends.
            permit.check()
            link.send([*holds[:index], (index, codec.enable()), holds[index]])
            missing = await self._exchange(
                link,
                lambda each: [link.codecs[each].enable(), holds[each][1]],
                lambda each: link.feedback[each].state is State.ENABLED,
                (index,),
            )
            if missing:
                state = link.feedback[index].state.name.lower().replace("_", " ")
                raise WireDown(f"enable: {link.names(missing)} did not take torque, it is {state}. Check the motor")
        permit.check()
        session.hold(goals)
        return session.observation()

    async def _set_up(self, link: Link) -> None:
        """Clear latched faults, and set timeout and mode of each motor. Both are read back.

        Raises:
            WireDown: A motor has a fault that stays, or does not confirm.
        """
        ticks = round(TIMEOUT_S * TICKS_PER_S)
        numbers = [(codec.TIMEOUT, codec.MODE) for codec in link.codecs]
        began_ns = self._clock.now_ns()
        await self._exchange(
            link,
            lambda index: [link.codecs[index].clear()],
            lambda index: link.stamp_ns[index] > began_ns and link.feedback[index].state is State.DISABLED,
        )
        for motor, feedback in zip(link.motors, link.feedback, strict=True):
            if feedback.state > State.ENABLED:
                state = feedback.state.name.lower().replace("_", " ")
                raise WireDown(f"enable: {motor.key} reports {state}. Clear the cause, then call resume()")
        for _ in range(ATTEMPTS):
            link.send(
                (index, codec.write(number, value))
                for index, codec in enumerate(link.codecs)
                for number, value in ((codec.TIMEOUT, ticks), (codec.MODE, codec.MIT))
            )
            await self._read_parameters(link, numbers)
            wrong = [
                index
                for index, codec in enumerate(link.codecs)
                if self._whole(link, index, codec.TIMEOUT) != ticks
                or (self._whole(link, index, codec.MODE) or 0) & 0xFF != codec.MIT
            ]
            if not wrong:
                return
        raise WireDown(
            f"enable: {link.names(wrong)} did not confirm its timeout of {TIMEOUT_S:g} s and the MIT mode. "
            "Check the wires, and the firmware of the motor"
        )

    @staticmethod
    def _whole(link: Link, index: int, number: int) -> int | None:
        parameter = link.parameters.get((index, number))
        return None if parameter is None else parameter.whole

    async def _read_parameters(self, link: Link, numbers: Sequence[Sequence[int]]) -> list[int]:
        """Read parameters of all motors anew. Return the motors of which one is missing."""
        link.poll()
        link.parameters.clear()

        def lacking(index: int) -> list[int]:
            return [number for number in numbers[index] if (index, number) not in link.parameters]

        return await self._exchange(
            link,
            lambda index: [link.codecs[index].read(number) for number in lacking(index)],
            lambda index: not lacking(index),
        )

    async def _exchange(
        self,
        link: Link,
        question: Callable[[int], Iterable[Any]],
        is_done: Callable[[int], bool],
        indices: Sequence[int] | None = None,
    ) -> list[int]:
        """Send frames to motors until each is done, for at most ``ATTEMPTS`` times. Return those that are not."""
        waiting = list(range(self._count) if indices is None else indices)
        for _ in range(ATTEMPTS):
            waiting = [index for index in waiting if not is_done(index)]
            if not waiting:
                return []
            link.send((index, frame) for index in waiting for frame in question(index))
            with trio.move_on_after(ANSWER_S):
                while not all(map(is_done, waiting)):
                    await trio.sleep(0.001)
                    link.poll()
        return [index for index in waiting if not is_done(index)]

    async def read(self) -> Observation:
        session = self.session
        link, now_ns = session.link, self._clock.now_ns()
        link.poll()
        if now_ns - session.sent_ns >= max(IDLE_S, 2 * self._config.control_s) * NS:
            session.sent_ns = now_ns
            link.send((index, codec.ask()) for index, codec in enumerate(link.codecs))
        silent_s = (now_ns - max(link.stamp_ns)) / NS
        if silent_s > LOST_S:
            raise WireDown(f"read: no motor has answered for {silent_s:.1f} s. Check the power and the bus")
        return session.observation()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        session, count = self.session, self._count
        if not session.target:
            raise PermitDenied("not armed")
        rows = [values[count * row : count * (row + 1)] for row in range(len(ROWS))]
        commands = (
            Command(q, dq, tau + weight, kp, kd)
            for q, dq, tau, kp, kd, weight in zip(*rows, session.weight(), strict=True)
        )
        frames = session.link.command(commands)
        permit.check()
        session.link.send(frames)
        session.target, session.holds, session.sent_ns = list(rows[0]), False, self._clock.now_ns()

    async def feed(self) -> None:
        """Repeat a hold, before the motors' timeout ends. While setpoints come, they do that."""
        session = self.session
        if session.holds and self._clock.now_ns() - session.sent_ns >= 0.9 * self._config.control_s * NS:
            session.sent_ns = self._clock.now_ns()
            session.link.send(session.hold_frames(session.target))

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return failed(self._config, "not connected")
        is_armed = bool(session.target)
        if is_armed and safe_state is SafeState.HOLD:
            return await self._hold(session)
        if is_armed and safe_state is SafeState.LOWERED and not await self._lower(session):
            self.ended_in = SafeState.DAMP
        session.target, session.holds = [], False
        return await bring_down(session.link, safe_state)

    async def _hold(self, session: CanSession) -> tuple[MotorReport, ...]:
        link, goals = session.link, session.present_goals()
        failures = session.hold(goals)
        began_ns = self._clock.now_ns()
        details = list(self._why_not_held(link, began_ns))
        with contextlib.suppress(WireDown), trio.move_on_after(HOLD_S):
            while any(details):
                await trio.sleep(PERIOD_S)
                link.poll()
                session.hold(goals)
                details = list(self._why_not_held(link, began_ns))
        if any(details) and self._config.arm.on_silence == "damp":
            self.hold_failed = next(
                f"{motor.key}: {why}" for motor, why in zip(link.motors, details, strict=True) if why
            )
            session.target, session.holds = [], False
            return await bring_down(link, SafeState.DAMP)
        return tuple(
            MotorReport(
                motor.key,
                motor.id,
                not failures.get(index, ""),
                link.stamp_ns[index] > began_ns,
                not detail,
                detail,
                None if detail else goals[index],
            )
            for index, (motor, detail) in enumerate(zip(link.motors, details, strict=True))
        )

    @staticmethod
    def _why_not_held(link: Link, since_ns: int) -> Iterable[str]:
        """Yield for each motor why it does not hold; empty if its feedback since a time shows that it does."""
        for feedback, stamp_ns in zip(link.feedback, link.stamp_ns, strict=True):
            if stamp_ns <= since_ns:
                yield "silent"
            else:
                yield "" if feedback.state is State.ENABLED else feedback.state.name.lower().replace("_", " ")

    async def _lower(self, session: CanSession) -> bool:
        """Bring the arm to its rest pose, with torque. Return False if something is in the way."""
        rest, lower_s = self._config.arm.rest, self._config.lower_s
        session.hold(session.present_goals())
        if rest is None:
            return False
        self._lowering = True
        try:
            link = session.link
            keys = [motor.key for motor in link.motors]
            path = RestPath(Chain(self._config.model, keys), session.target, rest)
            began_ns = self._clock.now_ns()
            async with aclosing(self._clock.ticks(self._config.control_s)) as ticks:
                async for now_ns in ticks:
                    link.poll()
                    passed_s = (now_ns - began_ns) / NS
                    goals = path.pose_after(passed_s)
                    behind = max(map(lambda goal, seen: abs(goal - seen.position), goals, link.feedback))
                    late = link.silent(now_ns - round(LOST_S * NS))
                    if late or behind > BLOCKED_RAD or any(self._why_not_held(link, 0)):
                        return False
                    if passed_s >= min(path.seconds, lower_s):
                        return path.seconds <= lower_s
                    session.hold(goals)
        except WireDown:
            return False
        finally:
            self._lowering = False
        return False

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the arm although the connection may be lost: on the open buses, then on buses opened anew."""
        session = self.session_or_none
        if session is not None:
            reports = await bring_down(session.link, safe_state)
            if any(report.acknowledged for report in reports):
                return reports
            self.close()
        try:
            link = Link.open(self._config, self._clock, self._open_port)
        except WireDown as down:
            return failed(self._config, str(down), session is not None and any(each.written for each in reports))
        try:
            return await bring_down(link, safe_state)
        finally:
            link.close()

    def handover(self) -> tuple[int, ...]:
        return tuple(port.fileno() for port in self.session.link.ports)

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.link.close()
        self.session_or_none = None

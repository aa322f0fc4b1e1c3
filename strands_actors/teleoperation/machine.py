"""What a leader's frames become: nothing, an approach, or setpoints. Pure: no clock, no I/O.

``idle``      nothing is sent: the robot holds
``aligning``  the dead-man is held, and the robot goes to where the leader is, slowly
``engaged``   the dead-man is held, and the robot follows

Every way out leads to ``idle``, and the only way on is a new press of the dead-man: one that was
held before anything was there to be engaged counts as not held.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from strands_actors.contract.axis import Axis, AxisMode, finite
from strands_actors.kernel.clock import NS

ALIGN_DEG = 15.0
"""A joint that differs by more is not engaged: somebody would be surprised."""
APPROACH_DEG_S = 30.0
ALIGNED_DEG = 2.0
SILENT_NS = 100_000_000
"""A frame that is older is none: as long as a setpoint lives."""
JOG_SHARE_S = 0.1
"""Of its range, what an axis that is jogged at full rate does in a second."""
JOG_UNBOUNDED = 0.1
"""Units a second of an axis without a range: a slide of a user's own model."""
LONGEST_STEP_S = 0.05
"""A jogged target goes on by no more at once, however long there was no frame."""
TOLERANCE = 1.5
"""Frames jitter: one may step so much further than the axis moves in its time."""

DEGREES = {"deg": 1.0, "rad": math.degrees(1.0), "percent": 1.0}
"""Of one unit. A gripper's percent counts as a degree."""
GRIPPER_UNIT = "percent"
"""However far a gripper is from its leader's, it is approached: who squeezes the leader's to engage
it could not have it elsewhere."""

NOT_HELD = "the dead-man is not held"
NOT_ANEW = "the dead-man is held, but was not let go of first. let go and press anew"


class State(enum.StrEnum):
    IDLE = "idle"
    ALIGNING = "aligning"
    ENGAGED = "engaged"


class Kind(enum.StrEnum):
    """What the numbers of a frame mean."""

    ABSOLUTE = "absolute"  # where the robot is to be
    RELATIVE = "relative"  # where the robot is to be, less what differed when it was engaged
    JOG = "jog"  # -1..1: how fast each axis is to go


class Frame(NamedTuple):
    """What was read of a leader, in the robot's axes and units."""

    t_ns: int  # when it was measured
    held: bool  # the dead-man
    values: Mapping[str, float]
    let_go: bool | None = None  # somebody said so, and was not only silent; None: not held is let go

    @property
    def is_let_go(self) -> bool:
        return not self.held if self.let_go is None else self.let_go


class Step(NamedTuple):
    """What is to be done with a frame."""

    target: dict[str, float] | None = None  # sent; None: nothing is
    engage: bool = False  # take the lease, then ``engage``
    let_go: bool = False  # give the lease back: the robot holds


_NOTHING = Step()


class Machine:
    """``axes``: the robot's own. ``kind``: of the leader. ``max_speed``: degrees a second, where
    that is less than what the axis can do. Raise ``ValueError`` when no axis can be led."""

    def __init__(self, axes: Sequence[Axis], kind: Kind, max_speed: float = math.inf) -> None:
        self._axes = {axis.key: axis for axis in axes}
        self._kind = kind
        self._max_speed = max_speed
        self._armed = False  # the dead-man was seen released
        self._target: dict[str, float] = {}
        self._offset: dict[str, float] = {}
        self._sent_ns = 0
        self._before: tuple[dict[str, float], int] = {}, 0  # target and time, of the frame before
        self.state = State.IDLE
        self.why = NOT_HELD
        """Why nothing is sent, or what keeps the robot from being engaged."""
        self.differs: dict[str, float] = {}
        """Joints that differ too much to be engaged, in their unit."""
        self.refused = 0
        """Frames that would have been too fast."""
        self.at_end: tuple[str, ...] = ()
        """Axes that are led beyond their range, and stay at its end."""

    def step(self, frame: Frame, now_ns: int) -> Step:
        """Take one frame up."""
        if self.state is not State.IDLE:
            if now_ns - frame.t_ns > SILENT_NS:
                return self.idle(f"the leader is silent for {(now_ns - frame.t_ns) / 1e6:.0f} ms")
            if not frame.held:
                self._armed = frame.is_let_go
                return self.idle(NOT_HELD)
            return self._follow(frame, now_ns)
        if not frame.held:
            self._armed = self._armed or frame.is_let_go
            self.why, self.differs = NOT_HELD, {}
            return _NOTHING
        if not self._armed and self.why == NOT_HELD:
            self.why = NOT_ANEW
        if not self._armed or now_ns - frame.t_ns > SILENT_NS:
            return _NOTHING
        return Step(engage=True)

    def engage(self, frame: Frame, follower: Mapping[str, float], now_ns: int) -> Step:
        """The lease is there, and the robot is at ``follower``."""
        self._armed = False
        unknown = [str(key) for key in frame.values if key not in self._axes]
        if unknown or not frame.values:
            known = ", ".join(self._axes)
            return self.idle(f"the leader has {', '.join(unknown) or 'no axis'}, the robot has {known}: use map_fn")
        self._target = {key: follower[key] for key in frame.values}
        self._offset = {}
        self._sent_ns = now_ns
        if wrong := self._wrong(frame):
            return self.idle(wrong)
        if self._kind is Kind.ABSOLUTE:
            self.differs = self._far(frame)
            if self.differs:
                return self.idle(self._too_far())
            self.state, self.why = State.ALIGNING, ""
        else:
            if self._kind is Kind.RELATIVE:
                self._offset = {key: follower[key] - value for key, value in frame.values.items()}
            self.state, self.why, self.differs = State.ENGAGED, "", {}
        return _NOTHING

    def not_engaged(self, why: str) -> None:
        """What ``engage`` needs is not there."""
        self._armed = False
        self.why = why

    def idle(self, why: str) -> Step:
        """Go back to ``idle``, whatever the reason: the robot holds until the dead-man is pressed
        again."""
        was = self.state
        self.state, self.why, self.at_end = State.IDLE, why, ()
        return Step(let_go=was is not State.IDLE)

    def refuse(self) -> None:
        """The robot's gate has refused the last target: it counts as not sent."""
        self.refused += 1
        self._target, self._sent_ns = self._before

    # -- details

    def _follow(self, frame: Frame, now_ns: int) -> Step:
        if wrong := self._wrong(frame):
            self.refused += 1
            self.why = wrong
            return _NOTHING
        passed_s = max(0.0, (now_ns - self._sent_ns) / NS)
        if self._kind is Kind.JOG:
            return self._send(self._jogged(frame, min(passed_s, LONGEST_STEP_S)), now_ns)
        goal, self.at_end = self._within(
            {key: value + self._offset.get(key, 0.0) for key, value in frame.values.items()}
        )
        if self.state is State.ALIGNING:
            return self._approach(goal, frame, min(passed_s, LONGEST_STEP_S), now_ns)
        for key, value in goal.items():
            axis = self._axes[key]
            speed = min(axis.speed, self._max_speed / DEGREES.get(axis.unit, 1.0))
            if abs(value - self._target[key]) > speed * passed_s * TOLERANCE:
                self.refused += 1
                self.why = f"{key} is led faster than {speed:.0f} {axis.unit}/s"
                return _NOTHING
        self.why = ""
        return self._send(goal, now_ns)

    def _wrong(self, frame: Frame) -> str:
        """Why a frame is none; empty: it is one."""
        if frame.values.keys() != self._target.keys():
            return f"the leader tells of {', '.join(frame.values)}, it told of {', '.join(self._target)}"
        return next(
            (f"the leader's {key} is {value}" for key, value in frame.values.items() if finite(value) is None), ""
        )

    def _approach(self, goal: Mapping[str, float], frame: Frame, passed_s: float, now_ns: int) -> Step:
        self.differs = self._far(frame)
        if self.differs:
            return self.idle(self._too_far())
        target, aligned = {}, True
        for key, value in goal.items():
            degrees = DEGREES.get(self._axes[key].unit, 1.0)
            most = APPROACH_DEG_S / degrees * passed_s
            away = value - self._target[key]
            target[key] = self._target[key] + max(-most, min(most, away))
            aligned = aligned and abs(value - target[key]) * degrees <= ALIGNED_DEG
        if aligned:
            self.state = State.ENGAGED
        return self._send(target, now_ns)

    def _jogged(self, frame: Frame, passed_s: float) -> dict[str, float]:
        wanted = {}
        for key, rate in frame.values.items():
            axis, rate = self._axes[key], max(-1.0, min(1.0, rate))
            if axis.mode is AxisMode.VELOCITY:
                wanted[key] = axis.rest + rate * (axis.high if rate > 0 else -axis.low)
            else:
                wanted[key] = self._target[key] + rate * self._jog_speed(axis) * passed_s
        within, self.at_end = self._within(wanted)
        return within

    def _jog_speed(self, axis: Axis) -> float:
        span = axis.high - axis.low
        speed = JOG_SHARE_S * span if math.isfinite(span) else JOG_UNBOUNDED
        if axis.unit in DEGREES:
            speed = APPROACH_DEG_S / DEGREES[axis.unit]
        return min(speed, axis.speed, self._max_speed / DEGREES.get(axis.unit, 1.0))

    def _within(self, wanted: Mapping[str, float]) -> tuple[dict[str, float], tuple[str, ...]]:
        """Keep each axis inside its range: a leader goes further than its follower."""
        kept, at_end = {}, []
        for key, value in wanted.items():
            axis = self._axes[key]
            # An axis that rests beyond its end may stay there.
            low, high = min(axis.low, self._target[key]), max(axis.high, self._target[key])
            kept[key] = max(low, min(high, value))
            if kept[key] != value:
                at_end.append(key)
        return kept, tuple(at_end)

    def _far(self, frame: Frame) -> dict[str, float]:
        """Joints of the leader that are too far from where the robot was last told to be."""
        goal, _ = self._within(frame.values)
        away = {key: value - self._target[key] for key, value in goal.items()}
        return {
            key: value
            for key, value in away.items()
            if self._axes[key].unit != GRIPPER_UNIT
            and abs(value) * DEGREES.get(self._axes[key].unit, 1.0) > ALIGN_DEG
        }

    def _too_far(self) -> str:
        joints = ", ".join(f"{key} by {away:+.0f}" for key, away in self.differs.items())
        return f"the leader is elsewhere: {joints}. move it to within {ALIGN_DEG:g} degrees, then press again"

    def _send(self, target: dict[str, float], now_ns: int) -> Step:
        self._before = self._target, self._sent_ns
        self._target, self._sent_ns = target, now_ns
        return Step(target)


class Squeezes:
    """A dead-man for who has both hands on the leader: its gripper, squeezed twice within
    ``WITHIN_NS``, is held from then on, and released by two more."""

    WITHIN_NS = 1_200_000_000
    CLOSED, OPEN = 0.25, 0.5
    """Of the gripper's range."""

    def __init__(self, low: float, high: float) -> None:
        self._closed = low + self.CLOSED * (high - low)
        self._open = low + self.OPEN * (high - low)
        self._was_open = False
        self._first_ns = 0
        self.held = False

    def take(self, value: float, now_ns: int) -> bool:
        """Take one reading of the gripper up. Return whether it is held."""
        if value >= self._open:
            self._was_open = True
        elif value <= self._closed and self._was_open:
            self._was_open = False
            if self._first_ns and now_ns - self._first_ns <= self.WITHIN_NS:
                self.held, self._first_ns = not self.held, 0
            else:
                self._first_ns = now_ns
        return self.held

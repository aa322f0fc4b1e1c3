"""Decide which setpoint follows from a leader's frame, if any. Pure: no clock, no I/O.

``idle``      no setpoint is sent, and the robot holds
``aligning``  the dead-man is held, and the robot moves slowly to the leader's position
``engaged``   the dead-man is held, and the robot follows the leader

When the robot has reached the leader's position, it becomes ``engaged``. These events lead to ``idle``: a release
of the dead-man, a silent leader, a command that the robot refuses. Only a new press of the dead-man leads out of
``idle``. So the dead-man must be released first. A dead-man that was held before the robot could be engaged does
not count.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

from strands_actors.contract.axis import Axis, AxisMode, finite
from strands_actors.contract.pose_keys import POSE_KEYS, POSITION_KEYS
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

ALIGN_DEG = 15.0
"""If a joint of robot and leader differs by more, the robot is not engaged, since its motion would surprise
people."""
APPROACH_DEG_S = 30.0
ALIGNED_DEG = 2.0
SILENT_NS = 100_000_000
"""Greatest age of a frame. It is the lifetime of a setpoint."""
JOG_SHARE_S = 0.1
"""Speed of an axis that is jogged at full rate, as a share of its range per second."""
JOG_UNBOUNDED = 0.1
"""Speed of a jogged axis without a range, in units per second, such as a slide of a user's model."""
JOG_M_S = 0.1
JOG_RAD_S = math.radians(APPROACH_DEG_S)
"""Speed and turning speed of the tool that is jogged at full rate."""
LONGEST_STEP_S = 0.05
"""A jogged target moves on for at most this time at once, even after a longer pause between frames."""
TOLERANCE = 1.5
"""Factor by which one frame may exceed the speed of an axis, since frames jitter."""

DEGREES = {"deg": 1.0, "rad": math.degrees(1.0), "percent": 1.0}
"""Degrees per unit. One percent of a gripper counts as one degree."""
GRIPPER_UNIT = "percent"
"""Unit of a gripper. A gripper is always approached, even if it differs by more than ``ALIGN_DEG``: an
operator engages the robot by squeezing the leader's gripper, and so cannot align it."""

NOT_HELD = "the dead-man is not held"
NOT_ANEW = "the dead-man is held, but was not let go of first. Let go and press anew"


class State(enum.StrEnum):
    IDLE = "idle"
    ALIGNING = "aligning"
    ENGAGED = "engaged"


class Kind(enum.StrEnum):
    """The meaning of the numbers in a frame (reading) of the leader, as target, position or speed of each
    axis."""

    ABSOLUTE = "absolute"  # the target of each axis of the robot
    RELATIVE = "relative"  # a position; the robot repeats its changes since the robot was engaged
    JOG = "jog"  # the speed of each axis, as a share of its jog speed (-1 to 1)


class Tool(Protocol):
    """The tool of the robot's arm (``caller/poses/tool_targets``)."""

    def moved(
        self, before: Mapping[str, float], velocity: Mapping[str, float], passed_s: float
    ) -> dict[str, float] | Refused:
        """Return the joint targets after a motion of the tool at a constant velocity, in m/s and rad/s."""
        ...


class Frame(NamedTuple):
    """One reading of a leader, in the robot's axes and units.

    Attributes:
        t_ns: Time of the measurement.
        held: True if the dead-man is held.
        values: Values by axis. For ``Kind.JOG`` also rates of the tool, by the keys of its pose.
        let_go: True if the operator has reported the release of the dead-man. False if the operator was only
            silent. None if the source cannot distinguish the two; then a dead-man that is not held counts as
            released.
    """

    t_ns: int
    held: bool
    values: Mapping[str, float]
    let_go: bool | None = None

    @property
    def is_let_go(self) -> bool:
        return not self.held if self.let_go is None else self.let_go


class Step(NamedTuple):
    """The actions that follow from a frame of the leader.

    Attributes:
        target: The setpoint to send; None to send nothing.
        engage: True: acquire the lease (the right to command), then call ``Machine.engage``.
        let_go: True: release the lease. The robot then holds its position.
    """

    target: dict[str, float] | None = None
    engage: bool = False
    let_go: bool = False


_NOTHING = Step()


class Machine:
    """The state machine of one teleoperation. The module's docstring describes its states.

    Args:
        axes: The axes of the robot.
        kind: The kind of the leader's numbers.
        max_speed: Highest speed in degrees per second. The speed limit of each axis holds as well.
    """

    tool: Tool | None = None
    """The tool that an operator can jog; None if there is none, or if it is not ready yet."""

    def __init__(self, axes: Sequence[Axis], kind: Kind, max_speed: float = math.inf) -> None:
        self._axes = {axis.key: axis for axis in axes}
        self._kind = kind
        self._max_speed = max_speed
        self._may_engage = False  # True after the dead-man was released, so that a press engages the robot
        self._target: dict[str, float] = {}
        self._offset: dict[str, float] = {}
        self._sent_ns = 0
        self._before: tuple[dict[str, float], int] = {}, 0  # the previous target, and the time it was sent
        self.state = State.IDLE
        self.reason = NOT_HELD
        """Why nothing is sent, or why the robot is not engaged."""
        self.differs: dict[str, float] = {}
        """Difference by joint, of joints that differ too much to be engaged, in their unit."""
        self.refused = 0
        """Number of refused frames, such as those that were too fast."""
        self.limited_axes: tuple[str, ...] = ()
        """Axes with a target beyond their range. They stay at its end."""

    def step(self, frame: Frame, now_ns: int) -> Step:
        """Process one frame of the leader, and return the actions that follow from it."""
        if self.state is not State.IDLE:
            if now_ns - frame.t_ns > SILENT_NS:
                return self.idle(f"the leader is silent for {(now_ns - frame.t_ns) / 1e6:.0f} ms")
            if not frame.held:
                self._may_engage = frame.is_let_go
                return self.idle(NOT_HELD)
            return self._follow(frame, now_ns)
        if not frame.held:
            self._may_engage = self._may_engage or frame.is_let_go
            self.reason, self.differs = NOT_HELD, {}
            return _NOTHING
        if not self._may_engage and self.reason == NOT_HELD:
            self.reason = NOT_ANEW
        if not self._may_engage or now_ns - frame.t_ns > SILENT_NS:
            return _NOTHING
        return Step(engage=True)

    def engage(self, frame: Frame, follower: Mapping[str, float], now_ns: int) -> Step:
        """Engage the robot (let it follow the leader), after the lease is acquired.

        Args:
            frame: The newest frame.
            follower: Measured position of the robot by axis.
            now_ns: The time.

        Returns:
            The actions that follow. If the robot could not be engaged, ``state`` is idle and ``reason`` is set.
        """
        self._may_engage = False
        values = _of_axes(frame)
        unknown = [str(key) for key in values if key not in self._axes]
        if unknown or not values:
            names = ", ".join(self._axes)
            return self.idle(f"the leader has {', '.join(unknown) or 'no axis'}, the robot has {names}: use map_fn")
        self._target = {key: follower[key] for key in values}
        self._offset = {}
        self._sent_ns = now_ns
        if wrong := self._wrong(frame):
            return self.idle(wrong)
        if self._kind is Kind.ABSOLUTE:
            self.differs = self._far(frame)
            if self.differs:
                return self.idle(self._too_far())
            self.state, self.reason = State.ALIGNING, ""
        else:
            if self._kind is Kind.RELATIVE:
                self._offset = {key: follower[key] - value for key, value in frame.values.items()}
            self.state, self.reason, self.differs = State.ENGAGED, "", {}
        return _NOTHING

    def not_engaged(self, reason: str) -> None:
        """Store the reason why the robot could not be engaged. Then the dead-man must be pressed anew."""
        self._may_engage = False
        self.reason = reason

    def idle(self, reason: str) -> Step:
        """Go to ``idle``. The robot holds until the dead-man is pressed again."""
        before = self.state
        self.state, self.reason, self.limited_axes = State.IDLE, reason, ()
        return Step(let_go=before is not State.IDLE)

    def refuse(self) -> None:
        """Return to the previous target, because the robot has refused the last one."""
        self.refused += 1
        self._target, self._sent_ns = self._before

    # -- details

    def _follow(self, frame: Frame, now_ns: int) -> Step:
        if wrong := self._wrong(frame):
            self.refused += 1
            self.reason = wrong
            return _NOTHING
        passed_s = max(0.0, (now_ns - self._sent_ns) / NS)
        if self._kind is Kind.JOG:
            return self._send(self._jogged(frame, min(passed_s, LONGEST_STEP_S)), now_ns)
        goal, self.limited_axes = self._within(
            {key: value + self._offset.get(key, 0.0) for key, value in frame.values.items()}
        )
        if self.state is State.ALIGNING:
            return self._approach(goal, frame, min(passed_s, LONGEST_STEP_S), now_ns)
        for key, value in goal.items():
            axis = self._axes[key]
            speed = min(axis.speed, self._max_speed / DEGREES.get(axis.unit, 1.0))
            if abs(value - self._target[key]) > speed * passed_s * TOLERANCE:
                self.refused += 1
                self.reason = f"{key} is led faster than {speed:.0f} {axis.unit}/s"
                return _NOTHING
        self.reason = ""
        return self._send(goal, now_ns)

    def _wrong(self, frame: Frame) -> str:
        """Return why a frame of the leader cannot be used; empty if it can."""
        if _of_axes(frame).keys() != self._target.keys():
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
        targets = {}
        for key, rate in _of_axes(frame).items():
            axis, rate = self._axes[key], max(-1.0, min(1.0, rate))
            if axis.mode is AxisMode.VELOCITY:
                targets[key] = axis.rest + rate * (axis.high if rate > 0 else -axis.low)
            else:
                targets[key] = self._target[key] + rate * self._jog_speed(axis) * passed_s
        within, self.limited_axes = self._within({**targets, **self._jogged_tool(frame, passed_s)})
        return within

    def _jogged_tool(self, frame: Frame, passed_s: float) -> dict[str, float]:
        """Return the joint targets that move the tool on. Near a singularity the tool moves more slowly."""
        rates = {key: max(-1.0, min(1.0, frame.values.get(key, 0.0))) for key in POSE_KEYS}
        self.reason = ""
        if self.tool is None or not any(rates.values()):
            return {}
        velocity = {key: rate * (JOG_M_S if key in POSITION_KEYS else JOG_RAD_S) for key, rate in rates.items()}
        moved = self.tool.moved(self._target, velocity, passed_s)
        if isinstance(moved, Refused):
            self.reason = moved.text
            return {}
        steps = {key: value - self._target[key] for key, value in moved.items()}
        most = {key: self._jog_speed(self._axes[key]) * passed_s for key in steps}
        share = min([1.0, *(most[key] / abs(step) for key, step in steps.items() if abs(step) > most[key])])
        return {key: self._target[key] + share * step for key, step in steps.items()}

    def _jog_speed(self, axis: Axis) -> float:
        span = axis.high - axis.low
        speed = JOG_SHARE_S * span if math.isfinite(span) else JOG_UNBOUNDED
        if axis.unit in DEGREES:
            speed = APPROACH_DEG_S / DEGREES[axis.unit]
        return min(speed, axis.speed, self._max_speed / DEGREES.get(axis.unit, 1.0))

    def _within(self, targets: Mapping[str, float]) -> tuple[dict[str, float], tuple[str, ...]]:
        """Limit each value to the range of its axis, because a leader may have a wider range than the robot."""
        kept, limited = {}, []
        for key, value in targets.items():
            axis = self._axes[key]
            # An axis that is already out of its range may stay at its position.
            low, high = min(axis.low, self._target[key]), max(axis.high, self._target[key])
            kept[key] = max(low, min(high, value))
            if kept[key] != value:
                limited.append(key)
        return kept, tuple(limited)

    def _far(self, frame: Frame) -> dict[str, float]:
        """Return the difference by joint, for each joint of the leader that is too far from the robot's last
        target.
        """
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
        return f"the leader is too far away: {joints}. Move it to within {ALIGN_DEG:g} degrees, then press again"

    def _send(self, target: dict[str, float], now_ns: int) -> Step:
        self._before = self._target, self._sent_ns
        self._target, self._sent_ns = target, now_ns
        return Step(target)


def _of_axes(frame: Frame) -> dict[str, float]:
    """Return the values of the robot's axes, without the rates of its tool."""
    return {key: value for key, value in frame.values.items() if key not in POSE_KEYS}


class Squeezes:
    """A dead-man for an operator with both hands on the leader.

    Two squeezes of the leader's gripper within ``WITHIN_NS`` count as pressing the dead-man. Two more squeezes
    release it.

    Args:
        low: The gripper's value when it is closed.
        high: The gripper's value when it is open.
    """

    WITHIN_NS = 1_200_000_000
    CLOSED, OPEN = 0.25, 0.5
    """Below ``CLOSED`` and above ``OPEN`` the gripper counts as closed and as open. Shares of its range."""

    def __init__(self, low: float, high: float) -> None:
        self._closed = low + self.CLOSED * (high - low)
        self._open = low + self.OPEN * (high - low)
        self._was_open = False
        self._first_ns = 0
        self.held = False

    def take(self, value: float, now_ns: int) -> bool:
        """Process one reading of the gripper. Return True if the dead-man counts as held."""
        if value >= self._open:
            self._was_open = True
        elif value <= self._closed and self._was_open:
            self._was_open = False
            if self._first_ns and now_ns - self._first_ns <= self.WITHIN_NS:
                self.held, self._first_ns = not self.held, 0
            else:
                self._first_ns = now_ns
        return self.held

"""The state machine of a teleoperation, without processes: the commands that it makes from frames."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.caller.poses import refusals
from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.kernel.messages import Refused
from strands_actors.teleoperation.machine import (
    ALIGN_DEG,
    APPROACH_DEG_S,
    JOG_M_S,
    SILENT_NS,
    TOLERANCE,
    Frame,
    Kind,
    Machine,
    Squeezes,
    State,
)

MS = 1_000_000
PERIOD_NS = 10 * MS
AXES = (
    Axis(key="pan", unit="deg", low=-110.0, high=110.0, speed=300.0),
    Axis(key="lift", unit="deg", low=-100.0, high=100.0, speed=300.0),
    Axis(key="jaw", unit="percent", low=0.0, high=100.0, speed=300.0),
)
AT_REST = {"pan": 0.0, "lift": 0.0, "jaw": 50.0}


class Bench:
    """A machine with its clock, and a robot that reaches each target at once."""

    def __init__(self, kind: Kind = Kind.ABSOLUTE, max_speed: float = math.inf, **robot: float) -> None:
        self.machine = Machine(AXES, kind, max_speed)
        self.now_ns = 1_000 * MS
        self.robot = {**AT_REST, **robot}
        self.sent: list[dict[str, float]] = []
        self.let_go = 0

    def frame(self, held: bool = True, age_ns: int = 0, **values: float) -> None:
        self.now_ns += PERIOD_NS
        frame = Frame(self.now_ns - age_ns, held, {**AT_REST, **values} if self.is_arm else values)
        step = self.machine.step(frame, self.now_ns)
        if step.engage:
            step = self.machine.engage(frame, self.robot, self.now_ns)
            if self.machine.state is State.IDLE:
                self.machine.not_engaged(self.machine.reason)
        self.let_go += step.let_go
        if step.target is not None:
            self.sent.append(step.target)
            self.robot |= step.target

    @property
    def is_arm(self) -> bool:
        return self.machine._kind is not Kind.JOG

    def press(self, **values: float) -> None:
        """Release the dead-man, then press it."""
        self.frame(held=False, **values)
        self.frame(**values)

    def engage(self, **values: float) -> None:
        self.press(**values)
        for _ in range(300):
            if self.machine.state is not State.ALIGNING:
                break
            self.frame(**values)
        assert self.machine.state is State.ENGAGED


def test_nothing_is_sent_while_the_dead_man_is_not_held() -> None:
    bench = Bench()
    for pan in range(50):
        bench.frame(held=False, pan=float(pan))
    assert bench.sent == [] and bench.machine.state is State.IDLE


def test_a_dead_man_that_was_held_from_the_beginning_counts_as_not_held() -> None:
    bench = Bench()
    for _ in range(50):
        bench.frame()
    assert bench.sent == []
    assert "Let go and press anew" in bench.machine.reason
    bench.press()
    bench.frame()
    assert bench.sent


def test_a_joint_that_differs_by_more_than_15_degrees_is_not_engaged() -> None:
    bench = Bench()
    bench.press(pan=ALIGN_DEG + 0.5)
    for _ in range(20):
        bench.frame(pan=ALIGN_DEG + 0.5)
    assert bench.sent == [] and bench.machine.state is State.IDLE
    assert set(bench.machine.differs) == {"pan"} and "pan by +16" in bench.machine.reason
    for _ in range(20):  # it comes near while the dead-man is held, so a new press is needed
        bench.frame(pan=1.0)
    assert bench.sent == []
    bench.engage(pan=1.0)


def test_a_joint_that_differs_by_less_is_approached_at_30_degrees_a_second() -> None:
    bench = Bench()
    bench.press(pan=14.0, lift=-5.0)
    assert bench.machine.state is State.ALIGNING
    before, took = {"pan": 0.0, "lift": 0.0}, 0
    while bench.machine.state is State.ALIGNING:
        bench.frame(pan=14.0, lift=-5.0)
        took += 1
        for key in before:
            assert abs(bench.sent[-1][key] - before[key]) <= APPROACH_DEG_S * 0.01 + 1e-9
        before = bench.sent[-1]
    assert took == pytest.approx((14.0 - 2.0) / APPROACH_DEG_S / 0.01, abs=2)
    bench.frame(pan=14.0, lift=-5.0)
    assert bench.sent[-1] == {"pan": 14.0, "lift": -5.0, "jaw": 50.0}


def test_a_leader_that_moves_away_during_alignment_is_released() -> None:
    bench = Bench()
    bench.press(pan=10.0)
    bench.frame(pan=10.0)
    bench.frame(pan=40.0)
    assert bench.machine.state is State.IDLE and bench.let_go == 1


def test_a_gripper_is_approached_from_anywhere_and_slowly() -> None:
    bench = Bench(jaw=0.0)
    bench.press(jaw=90.0)
    assert bench.machine.state is State.ALIGNING
    bench.frame(jaw=90.0)
    assert bench.sent[-1]["jaw"] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("state", ["aligning", "engaged"])
def test_releasing_the_dead_man_leads_to_a_hold_at_once(state: str) -> None:
    bench = Bench()
    if state == "engaged":
        bench.engage(pan=10.0)
    else:
        bench.press(pan=10.0)
        bench.frame(pan=10.0)
    count = len(bench.sent)
    bench.frame(held=False, pan=11.0)
    assert bench.machine.state is State.IDLE and bench.let_go == 1 and len(bench.sent) == count


def test_saf_001_a_frame_older_than_100_ms_leads_to_a_hold() -> None:
    bench = Bench()
    bench.engage()
    count = len(bench.sent)
    bench.frame(age_ns=SILENT_NS + 1)
    assert bench.machine.state is State.IDLE and bench.let_go == 1 and "silent" in bench.machine.reason
    for _ in range(20):
        bench.frame()
    assert len(bench.sent) == count, "only a new press continues the motion"


def test_a_frame_that_is_too_fast_is_refused_and_counted_and_the_next_is_taken() -> None:
    bench = Bench()
    bench.engage()
    count = len(bench.sent)
    bench.frame(pan=20.0)  # 2000 degrees a second
    assert bench.machine.refused == 1 and len(bench.sent) == count
    assert "pan is led faster than 300 deg/s" in bench.machine.reason
    bench.frame(pan=1.0)
    assert bench.machine.refused == 1 and bench.sent[-1]["pan"] == 1.0
    assert bench.machine.state is State.ENGAGED


def test_the_speed_limit_may_be_below_the_speed_of_the_axis() -> None:
    bench = Bench(max_speed=50.0)
    bench.engage()
    bench.frame(pan=0.5 * TOLERANCE - 0.01)
    assert bench.machine.refused == 0
    bench.frame(pan=3.0)
    assert bench.machine.refused == 1


def test_a_setpoint_that_the_gate_refused_counts_as_not_sent() -> None:
    bench = Bench()
    bench.engage()
    bench.frame(pan=3.0)
    bench.machine.refuse()
    assert bench.machine.refused == 1
    bench.frame(pan=3.0)
    assert bench.sent[-1]["pan"] == 3.0, "measured from where the robot is, with the time since then"


@pytest.mark.parametrize("values", [{"pan": math.nan}, {"pan": math.inf}, {"elbow": 1.0}])
def test_an_invalid_frame_is_refused(values: dict[str, float]) -> None:
    bench = Bench()
    bench.engage()
    count = len(bench.sent)
    bench.frame(**values)
    assert bench.machine.refused == 1 and len(bench.sent) == count


def test_a_leader_with_other_joints_is_not_engaged() -> None:
    bench = Bench()
    bench.press(elbow=1.0)
    assert bench.machine.state is State.IDLE and "the leader has elbow" in bench.machine.reason


def test_a_leader_beyond_the_range_keeps_its_follower_at_the_end() -> None:
    bench = Bench(pan=108.0)
    bench.engage(pan=108.0)
    for pan in (110.0, 112.0, 114.0):
        bench.frame(pan=pan)
    assert bench.sent[-1]["pan"] == 110.0 and bench.machine.limited_axes == ("pan",)
    assert bench.machine.refused == 0


def test_a_relative_leader_is_anchored_anew_at_each_press() -> None:
    bench = Bench(Kind.RELATIVE, pan=50.0)
    bench.engage(pan=-20.0)
    bench.frame(pan=-19.0)
    assert bench.sent[-1]["pan"] == 51.0
    bench.press(pan=-60.0)  # the hand has moved back in the meantime
    bench.frame(pan=-60.0)
    assert bench.sent[-1]["pan"] == 51.0, "SAF-011: no jump"
    bench.frame(pan=-59.0)
    assert bench.sent[-1]["pan"] == 52.0


def test_saf_011_an_absolute_leader_that_was_moved_meanwhile_is_not_jumped_to() -> None:
    bench = Bench()
    bench.engage()
    bench.frame(held=False)
    bench.press(pan=60.0)
    assert bench.machine.state is State.IDLE and set(bench.machine.differs) == {"pan"}


def test_a_jogged_axis_goes_on_from_where_the_robot_is() -> None:
    bench = Bench(Kind.JOG, pan=40.0)
    bench.press(pan=1.0)
    bench.frame(pan=1.0)
    assert bench.sent[-1]["pan"] == pytest.approx(40.0 + APPROACH_DEG_S * 0.01)
    bench.now_ns += 3_000 * MS  # no frame for 3 s
    before = bench.robot["pan"]
    bench.frame(pan=1.0)
    assert bench.robot["pan"] - before <= APPROACH_DEG_S * 0.05 + 1e-9


def test_a_jogged_velocity_rests_in_the_middle_and_has_the_range_at_full_rate() -> None:
    base = Axis(key="x", unit="m/s", low=-0.2, high=0.4, mode=AxisMode.VELOCITY)
    machine = Machine((base,), Kind.JOG)
    machine.step(Frame(0, False, {"x": 0.0}), 0)
    machine.engage(Frame(1, True, {"x": 0.0}), {"x": 0.0}, 1)
    for rate, speed in ((1.0, 0.4), (-1.0, -0.2), (0.0, 0.0), (9.0, 0.4)):
        assert machine.step(Frame(2, True, {"x": rate}), 2).target == {"x": speed}


def test_a_jogged_axis_without_a_range_moves_at_its_rate_and_not_without() -> None:
    slide = Axis(key="x", unit="m", low=-math.inf, high=math.inf)
    machine = Machine((slide,), Kind.JOG)
    machine.step(Frame(0, False, {"x": 0.0}), 0)
    machine.engage(Frame(1, True, {"x": 0.0}), {"x": 0.5}, 0)
    assert machine.step(Frame(2, True, {"x": 0.0}), 10 * MS).target == {"x": 0.5}
    assert machine.step(Frame(3, True, {"x": 1.0}), 20 * MS).target == {"x": pytest.approx(0.501)}


class Slide:
    """A tool that moves with the joint ``pan``, 100 degrees for each metre, up to 50 degrees."""

    def moved(
        self, before: Mapping[str, float], velocity: Mapping[str, float], passed_s: float
    ) -> dict[str, float] | Refused:
        pan = before["pan"] + 100.0 * velocity["ee.x"] * passed_s
        return {"pan": pan} if pan <= 50 else refusals.cannot_follow((0.0, 0.0, 0.0))


def test_a_jogged_tool_moves_its_joints_no_faster_than_a_jogged_joint() -> None:
    machine = Machine(AXES, Kind.JOG)
    still = {"pan": 0.0}
    machine.step(Frame(0, False, still), 0)
    machine.engage(Frame(1, True, still), AT_REST, 0)
    to_left = {**still, "ee.x": 1.0}
    assert machine.step(Frame(2, True, to_left), 10 * MS).target == still, "its model is not ready"
    machine.tool = Slide()
    target = machine.step(Frame(3, True, to_left), 20 * MS).target
    assert target == {"pan": pytest.approx(100.0 * JOG_M_S * 0.01)}
    quick = Machine(AXES, Kind.JOG, max_speed=5.0)
    quick.tool = machine.tool
    quick.step(Frame(0, False, still), 0)
    quick.engage(Frame(1, True, still), AT_REST, 0)
    assert quick.step(Frame(2, True, to_left), 10 * MS).target == {"pan": pytest.approx(0.05)}
    machine.engage(Frame(4, True, to_left), {**AT_REST, "pan": 49.95}, 30 * MS)
    assert machine.step(Frame(5, True, to_left), 40 * MS).target == {"pan": 49.95}
    assert "the tool cannot move on" in machine.reason
    machine.step(Frame(6, True, still), 50 * MS)
    assert machine.reason == ""


FRAMES = st.lists(
    st.tuples(
        st.booleans(),
        st.sampled_from([0, 0, 0, SILENT_NS + 1]),
        st.floats(-200, 200) | st.sampled_from([math.nan, math.inf]),
    ),
    max_size=60,
)


@given(FRAMES, st.sampled_from([Kind.ABSOLUTE, Kind.RELATIVE]))
def test_no_input_leads_to_a_setpoint_that_is_unheld_stale_outside_or_too_far(
    frames: list[tuple[bool, int, float]], kind: Kind
) -> None:
    bench = Bench(kind)
    pan, sent_ns = 0.0, bench.now_ns
    for held, age_ns, value in frames:
        count = len(bench.sent)
        bench.frame(held, age_ns, pan=value)
        if len(bench.sent) == count:
            continue
        assert held and age_ns <= SILENT_NS and math.isfinite(value)
        target = bench.sent[-1]["pan"]
        assert -110.0 <= target <= 110.0
        passed_s = (bench.now_ns - sent_ns) / 1e9
        assert abs(target - pan) <= 300.0 * passed_s * TOLERANCE + 1e-6
        pan, sent_ns = target, bench.now_ns


def test_a_gripper_squeezed_twice_is_held_until_it_is_squeezed_twice_again() -> None:
    squeezes = Squeezes(0.0, 100.0)

    def squeeze(at_ms: int) -> bool:
        squeezes.take(80.0, at_ms * MS)
        return squeezes.take(5.0, (at_ms + 50) * MS)

    assert not squeeze(0)
    assert squeeze(400)
    assert squeeze(5000), "one squeeze alone only closes the gripper"
    assert squeeze(8000)
    assert not squeeze(8400)
    assert not squeeze(20_000)
    assert not squeeze(22_000), "too slow for a double squeeze"


def test_silence_leads_to_a_hold_and_needs_a_new_press() -> None:
    """After a silence the operator may have held the dead-man all the time."""
    machine = Machine(AXES, Kind.JOG)
    still = {"pan": 0.0}
    machine.step(Frame(0, False, still, let_go=False), 0)
    assert not machine.step(Frame(1, True, still, let_go=False), 1).engage, "the dead-man was not released yet"
    machine.step(Frame(2, False, still, let_go=True), 2)
    assert machine.step(Frame(3, True, still, let_go=False), 3).engage
    machine.engage(Frame(3, True, still), AT_REST, 3)
    assert machine.step(Frame(4, False, still, let_go=False), 4).let_go
    assert not machine.step(Frame(5, True, still, let_go=False), 5).engage

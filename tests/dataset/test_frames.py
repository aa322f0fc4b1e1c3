"""Make frames from a journal: the state at the time of the frame, the decision that followed, and marks for
late or missing values."""

from __future__ import annotations

import math
from collections.abc import Mapping

from strands_actors.contract.sensors import ReadOnlyJoint
from strands_actors.surfaces.dataset.frames import NS, PATIENCE_S, Assembler, Axes, missed
from strands_actors.surfaces.dataset.staging import Row
from strands_actors.surfaces.recording.rows import Command, Gap, Lifecycle, Safe, Seen

PERIOD_NS = NS // 10
AXES = Axes(("a", "v"), frozenset({"v"}))
NONE: Mapping[str, list[float | None]] = {}


def ms(value: float) -> int:
    return 1_000_000_000_000 + round(value * 1e6)


class Robot:
    """Feed events to an assembler, with times in milliseconds."""

    def __init__(self, axes: Axes = AXES) -> None:
        self.assembler = Assembler(axes, 0.1)

    def sees(
        self,
        at: float,
        a: float | None,
        v: float = 0.0,
        oldest: float | None = None,
        sensors: Mapping[str, list[float | None]] = NONE,
    ) -> None:
        oldest_ns = ms(at if oldest is None else oldest)
        seen = Seen(ms(at), {"a": a, "v": v}, {}, dict(sensors), {}, oldest_ns)
        self.assembler.add_entries([("observation", ms(at), seen)])

    def moves(self, at: float, a: float, accepted: float | None = None, lease: int = 1) -> None:
        """Request a move to ``a``. It is refused unless ``accepted`` is given."""
        outcome = "refused" if accepted is None else "accepted"
        target: dict[str, float | None] = {} if accepted is None else {"a": accepted, "v": 0.5}
        command = Command("setpoint", "", outcome, lease, action={"a.pos": a}, target=target)
        self.assembler.add_entries([("command", ms(at), command)])

    def rows(self, *due: float, now: float = 100_000.0) -> list[Row]:
        for at in due:
            self.assembler.due(ms(at), {}, {})
        return [made.row for made in self.assembler.frames(ms(now))]


def test_a_frame_has_the_state_at_its_time_and_the_decision_after_it() -> None:
    robot = Robot()
    robot.sees(990, 1.0)
    robot.moves(995, 5.0, accepted=5.0)
    robot.sees(1010, 2.0)  # too late for the frame
    robot.moves(1090, 7.0, accepted=6.0)
    robot.moves(1105, 9.0, accepted=9.0)  # belongs to the next one
    robot.sees(1110, 3.0)
    (row,) = robot.rows(1000)
    assert row.state == (1.0, 0.0) and row.action == (6.0, 0.5)
    assert row.requested == (7.0, 0.5), "the requested value, not the value that the gate accepted"
    assert row.age_ms == (10.0,) and row.stale == () and row.gap == 0


def test_an_axis_that_the_robot_may_lack_is_left_out_when_it_was_never_read() -> None:
    robot = Robot(Axes(("a", "v", "claw"), frozenset({"v"}), ("rad", "m/s", "%"), frozenset({"claw"})))
    robot.sees(990, 1.0)
    assert robot.assembler.has_state(ms(1000)) and not robot.assembler.has_all
    assert robot.assembler.leave_out_absent() == Axes(
        ("a", "v"), frozenset({"v"}), ("rad", "m/s"), frozenset({"claw"})
    )
    assert robot.assembler.has_all and robot.rows(1000)[0].state == (1.0, 0.0)


def test_joints_that_are_only_read_stand_in_the_state_alone() -> None:
    legs = (ReadOnlyJoint("knee", "knee_rad", "rad"), ReadOnlyJoint("tail", "tail_rad", "rad"))
    robot = Robot(Axes(("a", "v"), frozenset({"v"}), read_only=legs))
    robot.sees(980, 1.0)
    assert not robot.assembler.has_all, "neither was read yet"
    robot.sees(990, 1.0, sensors={"knee_rad": [-1.5]})
    robot.moves(995, 5.0, accepted=5.0)
    robot.sees(996, 2.0)
    assert robot.assembler.leave_out_absent().state == ("a", "v", "knee")
    (row,) = robot.rows(1000)
    assert row.state == (1.0, 0.0, -1.5), "a reading without the knee is not used as a state"
    assert row.action == row.requested == (5.0, 0.5)


def test_an_optional_axis_that_was_read_once_belongs_to_every_state() -> None:
    robot = Robot(Axes(("a", "v"), frozenset({"v"}), optional=frozenset({"a"})))
    robot.sees(980, 1.0)
    robot.sees(990, None)
    assert robot.assembler.has_all and robot.assembler.unread == ("a",)
    assert robot.assembler.leave_out_absent().keys == ("a", "v")
    assert robot.rows(1000)[0].state == (1.0, 0.0), "the previous state"


def test_the_newest_state_of_a_slow_robot_is_not_late() -> None:
    robot = Robot(Axes(("a", "v"), frozenset({"v"}), cycle_s=0.2))
    robot.sees(800, 1.0)
    robot.sees(1200, 1.0, oldest=1100)
    assert [row.stale for row in robot.rows(1050, 1150, 1500)] == [(), ("state",), ("state",)]


def test_a_frame_waits_for_the_journal_but_not_for_ever() -> None:
    robot = Robot()
    robot.sees(990, 1.0)
    assert robot.rows(1000, now=1099) == [] and robot.assembler.waiting == 1
    robot.sees(1101, 2.0)
    assert len(robot.rows(now=1102)) == 1
    assert robot.rows(1200, now=1290) == []
    assert len(robot.rows(now=1301 + PATIENCE_S * 1000)) == 1


def test_a_refused_request_is_recorded_with_the_target_that_stays_in_force() -> None:
    robot = Robot()
    robot.sees(990, 1.0)
    robot.moves(995, 5.0, accepted=5.0)
    robot.moves(1010, 400.0)
    robot.moves(1020, float("nan"))
    robot.moves(1030, 77.0, lease=2)  # another writer, refused as well
    (row,) = robot.rows(1000)
    assert row.action == (5.0, 0.5) and row.requested == (400.0, 0.5)


def test_an_accepted_request_counts_even_if_its_lease_was_not_recorded() -> None:
    """The journal has a gap where the lease was given. The robot still moves on command."""
    robot = Robot()
    robot.sees(890, 0.0)
    robot.assembler.add_entries([("command", ms(891), Command("acquire", "x", "accepted", 1))])
    robot.moves(895, 5.0, accepted=5.0)
    robot.assembler.add_entries([("gap", ms(950), Gap("wire", 12, "the recorder was slower"))])
    robot.sees(990, 1.0)
    robot.moves(995, 7.0, accepted=7.0, lease=2)
    robot.moves(996, 50.0, lease=1)  # the last writer's, refused
    (row,) = robot.rows(1000)
    assert row.action == (7.0, 0.5) and row.requested == (7.0, 0.5)


def test_without_a_target_the_action_is_to_stay() -> None:
    robot = Robot()
    robot.sees(990, 1.0, v=0.3)
    assert robot.rows(1000)[0].action == (1.0, 0.0), "a position stays, a speed is zero"
    robot.moves(1105, 5.0, accepted=5.0)
    robot.sees(1190, 4.0)
    robot.sees(1290, 4.5)
    assert [row.action for row in robot.rows(1200)] == [(5.0, 0.5)]
    for what in (
        Safe("ordered", "limp", "stop", 2, "wire", False, 0.0, []),
        Lifecycle("state", mode="holding"),
        Gap("wire", 7, "the recorder was slower"),
    ):
        robot.moves(1291, 5.0, accepted=5.0)
        robot.assembler.add_entries([("", ms(1292), what)])
        assert robot.rows(1300)[0].action == (4.5, 0.0), what


def test_a_reading_older_than_a_period_and_a_half_marks_its_frame() -> None:
    robot = Robot()
    robot.sees(1000, 1.0)
    robot.assembler.due(ms(1149), {}, {"wrist": 151.0})
    robot.assembler.due(ms(1151), {}, {"wrist": 149.0})
    assert [made.row.stale for made in robot.assembler.frames(ms(9000))] == [("wrist",), ("state",)]


def test_the_oldest_axis_counts() -> None:
    robot = Robot()
    robot.sees(1000, 1.0, oldest=800)
    (row,) = robot.rows(1010)
    assert row.age_ms == (210.0,) and row.stale == ("state",)


def test_without_a_state_there_is_no_frame_and_the_next_frame_is_marked() -> None:
    robot = Robot()
    assert robot.rows(1000, 1100) == []
    robot.sees(1150, None)  # an axis that was not read
    assert robot.rows(1200) == []
    robot.sees(1290, 1.0)
    assert [row.gap for row in robot.rows(1300, 1400)] == [3, 0]
    assert robot.rows(1300 + 1000) == [], "the last reading is too old by now"
    assert robot.assembler.take_gap() == 1 and robot.assembler.take_gap() == 0


def test_an_axis_that_is_nan_was_not_read_and_is_named() -> None:
    """A wire reports an axis that was never read as NaN: see ``Observation``."""
    robot = Robot()
    robot.sees(990, 1.0, v=math.nan)
    assert list(robot.assembler.unread) == ["v"] and not robot.assembler.has_state(ms(1000))
    assert robot.rows(1000) == []
    robot.sees(1090, 1.0)
    robot.moves(1095, 5.0, accepted=math.nan)
    (row,) = robot.rows(1100)
    assert not robot.assembler.unread and row.gap == 1
    assert row.action == (1.0, 0.5), "an axis without a target stays"


def test_a_request_that_no_column_can_have_is_not_recorded() -> None:
    robot = Robot()
    robot.sees(990, 1.0)
    robot.moves(995, 5.0, accepted=5.0)
    robot.moves(1010, 1e39)  # infinite in a float32
    (row,) = robot.rows(1000)
    assert row.requested == (5.0, 0.5)


def test_a_state_counts_for_a_limited_time() -> None:
    robot = Robot()
    assert not robot.assembler.has_state(ms(1000))
    robot.sees(1000, 1.0)
    assert robot.assembler.has_state(ms(1100)) and not robot.assembler.has_state(ms(1600))


def test_ticks_that_did_not_come_are_counted() -> None:
    assert missed(ms(1000), 0, PERIOD_NS) == 0
    assert missed(ms(1104), ms(1000), PERIOD_NS) == 0
    assert missed(ms(1290), ms(1000), PERIOD_NS) == 2


def test_an_episode_begins_without_the_frames_that_were_due_before() -> None:
    robot = Robot()
    robot.sees(990, 1.0)
    robot.assembler.due(ms(1000), {}, {})
    robot.assembler.count_missing(3)
    robot.assembler.begin()
    assert [row.gap for row in robot.rows(1010)] == [0]


def test_joints_are_spelled_as_lerobot_does() -> None:
    assert AXES.joints == ("a.pos", "v.vel")

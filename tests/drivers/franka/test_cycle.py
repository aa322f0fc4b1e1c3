"""Test the 1 kHz cycle without its process: states in, commands out."""

from __future__ import annotations

import random

import pytest

from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka.arms import HOME_RAD, arm_of
from strands_actors.drivers.franka.cycle import (
    FEED_S,
    STAND_DOWN,
    START_TICKS,
    Cycle,
    Order,
    Phase,
    Report,
    Reporter,
)
from strands_actors.drivers.franka.generator import limits_of
from strands_actors.drivers.franka.twin.controller import Controller
from strands_actors.kernel.health.heartbeat import pair

MS = 1_000_000
GOAL = tuple(rad + 0.05 for rad in HOME_RAD)


class Rig:
    """A cycle, and a controller that answers as a real one does."""

    def __init__(self, fci: int = 5) -> None:
        self.dialect = p.DIALECTS[fci]
        self.wire_heartbeat, heartbeat = pair()
        self.cycle = Cycle(self.dialect, limits_of(arm_of("panda"), 0.2), heartbeat)
        self.ms = 1000
        self.q_d: tuple[float, ...] = tuple(HOME_RAD)
        self.running = False
        self.sent: list[p.Command] = []
        self.fed = True

    def order(self, number: int, goal: tuple[float, ...] = GOAL) -> None:
        self.cycle.obey(Order(number, goal).pack())

    def state(self) -> bytes:
        data = bytearray(self.dialect.state_bytes)
        self.dialect.put(data, "message_id", self.ms)
        self.dialect.put(data, "q_d", *self.q_d)
        self.dialect.put(data, "generator", p.Generator.JOINT_POSITION if self.running else p.Generator.IDLE)
        self.dialect.put(data, "robot_mode", p.RobotMode.MOVE if self.running else p.RobotMode.IDLE)
        return bytes(data)

    def tick(self, count: int = 1, by: int = 1) -> p.Command | None:
        """Deliver states, ``by`` milliseconds apart. Return the last answer."""
        command = None
        for _ in range(count):
            self.ms += by
            if self.fed:
                self.wire_heartbeat.beat(self.ms * MS)
            answer = self.cycle.answer(self.state(), self.ms * MS)
            command = None if answer is None else self.dialect.command(answer)
            if command is not None:
                assert command.message_id == self.ms
                self.sent.append(command)
                self.q_d = command.q
                if command.finished and self.running:
                    self.running = False
        return command


@pytest.mark.parametrize("fci", [5, 10])
def test_a_goal_is_reached_and_the_motion_ended(fci: int) -> None:
    rig = Rig(fci)
    assert rig.tick(5) is None, "nothing is sent without an order"
    rig.order(1)
    assert rig.tick(5) is None, "nothing is sent before the controller has begun the motion"
    rig.running = True
    rig.tick(5000)
    assert rig.sent[0].q == pytest.approx(HOME_RAD, abs=1e-4), (
        "SAF-011: the motion begins at the arm's commanded position"
    )
    assert rig.q_d == pytest.approx(GOAL, abs=1e-6)
    assert [command.finished for command in rig.sent].count(True) == 1
    assert (rig.cycle.phase, rig.cycle.reached, rig.cycle.missed) == (Phase.IDLE, 1, 0)


def test_saf_002_nothing_is_sent_after_the_order_to_stand_down() -> None:
    rig = Rig()
    rig.order(1)
    rig.running = True
    assert rig.tick(50) is not None
    rig.cycle.obey(STAND_DOWN.pack())
    assert rig.tick(50) is None, "nothing is sent although the controller still shows the motion"
    assert rig.cycle.reached == 0


def test_a_new_goal_on_the_way() -> None:
    rig = Rig()
    rig.order(1)
    rig.running = True
    rig.tick(100)
    back = tuple(rad - 0.02 for rad in HOME_RAD)
    rig.order(2, back)
    rig.tick(5000)
    assert rig.q_d == pytest.approx(back, abs=1e-6)
    assert rig.cycle.reached == 2


def test_saf_004_the_cycle_brakes_when_the_setpoint_is_not_renewed() -> None:
    rig = Rig()
    rig.order(1, tuple(rad + 0.5 for rad in HOME_RAD))
    rig.running = True
    rig.tick(300)
    rig.fed = False
    rig.tick(round(FEED_S * 1000) - 1)
    moving = abs(rig.sent[-1].q[0] - rig.sent[-2].q[0])
    assert moving > 1e-5
    rig.tick(400)
    assert not rig.running, "the motion has ended"
    assert rig.cycle.phase is Phase.IDLE
    assert rig.cycle.reached == 0, "the goal does not count as reached"
    assert rig.q_d[0] < HOME_RAD[0] + 0.4


def test_saf_004_a_setpoint_that_is_renewed_while_braking_does_not_go_on() -> None:
    rig = Rig()
    rig.order(1, tuple(rad + 0.5 for rad in HOME_RAD))
    rig.running = True
    rig.tick(300)
    rig.fed = False
    rig.tick(round(FEED_S * 1000) + 5)
    rig.fed = True
    rig.order(2, tuple(rad + 0.6 for rad in HOME_RAD))
    rig.tick(500)
    assert not rig.running and rig.cycle.phase is Phase.IDLE


def test_states_that_were_missed_are_counted_and_the_path_keeps_its_time() -> None:
    rig, even = Rig(), Rig()
    for one in (rig, even):
        one.order(1)
        one.running = True
    rig.tick(100)
    rig.tick(1, by=4)
    rig.tick(1, by=1)
    even.tick(105)
    assert rig.cycle.missed == 3
    assert rig.q_d == pytest.approx(even.q_d)


def test_a_motion_that_the_controller_ends_is_left() -> None:
    rig = Rig()
    rig.order(1)
    rig.running = True
    rig.tick(50)
    rig.running = False
    assert rig.tick(50) is None
    rig.running = True
    assert rig.tick(50) is None, "nothing is sent into the motion of another client"


def test_a_motion_that_does_not_begin_is_given_up() -> None:
    rig = Rig()
    rig.order(1)
    rig.tick(START_TICKS + 1)
    assert rig.cycle.phase is Phase.IDLE
    rig.running = True
    assert rig.tick(10) is None


@pytest.mark.parametrize("jump", [-500, 0, 10**9, 2**63])
def test_a_number_that_no_state_of_this_controller_has_is_not_answered(jump: int) -> None:
    rig = Rig()
    rig.order(1)
    rig.running = True
    rig.tick(20)
    at, rig.ms = rig.ms, rig.ms + jump
    assert rig.cycle.answer(rig.state(), at * MS) is None
    rig.ms = at
    assert rig.tick() is not None


def test_saf_012_a_controller_with_a_frozen_clock_counts_as_silent() -> None:
    rig = Rig()
    assert rig.cycle.is_news(rig.state())
    assert not rig.cycle.is_news(rig.state())
    rig.ms += 1
    assert rig.cycle.is_news(rig.state())
    assert not rig.cycle.is_news(rig.state()[:-1])
    assert not rig.cycle.is_news(b"")


def test_saf_022_an_old_state_is_no_life() -> None:
    rig = Rig()
    rig.ms = 5000
    assert rig.cycle.is_news(rig.state())
    rig.ms = 4990
    assert not rig.cycle.is_news(rig.state())
    rig.ms = 1 << 40
    assert not rig.cycle.is_news(rig.state())
    rig.ms = 5001
    assert rig.cycle.is_news(rig.state())


@pytest.mark.parametrize("fci", [5, 10])
@pytest.mark.parametrize("row", ["q", "q_d", "dq"])
@pytest.mark.parametrize("number", [float("nan"), float("inf"), -1000.0])
def test_saf_012_a_state_without_joints_does_not_count_as_alive(fci: int, row: str, number: float) -> None:
    """The wire gets no position from it. Its last reading would grow old on a link that is up."""
    rig = Rig(fci)
    assert rig.cycle.is_news(rig.state())
    rig.ms += 1
    state = bytearray(rig.state())
    rig.dialect.put(state, row, *(0.0,) * 6, number)
    assert not rig.cycle.is_news(bytes(state))
    assert rig.cycle.is_news(rig.state())


def test_a_start_that_is_no_position_is_not_begun_from() -> None:
    rig = Rig()
    rig.order(1)
    rig.running = True
    rig.q_d = (float("nan"),) * 7
    assert rig.tick() is None
    rig.q_d = tuple(HOME_RAD)
    assert rig.tick() is not None


def test_an_invalid_order_is_ignored() -> None:
    rig = Rig()
    rig.cycle.obey(b"")
    rig.cycle.obey(bytes(63))
    assert rig.cycle.phase is Phase.IDLE


def test_the_wire_gets_the_state_of_each_stride_and_every_change() -> None:
    rig = Rig()
    reporter = Reporter(rig.dialect, 33)
    told = []
    for ms in range(1, 200):
        rig.ms = ms
        rig.running = ms >= 100
        if reporter.is_due(rig.state(), Phase.IDLE):
            told.append(ms)
    assert told == [1, 34, 67, 100, 133, 166, 199]
    rig.ms = 5
    assert reporter.is_due(rig.state(), Phase.IDLE), "the state of a restarted controller is reported"


def test_a_report_there_and_back() -> None:
    report = Report(Phase.MOVING, 3, 7, 123456789, b"state")
    assert Report.unpack(report.pack()) == report


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("robot", ["panda", "fr3"])
@pytest.mark.parametrize("late", [True, False], ids=["answers come too late", "states are lost"])
def test_the_next_command_starts_where_the_controller_has_continued_to(robot: str, late: bool) -> None:
    """One to three commands are missing, a hundred times. The twin's controller has its limits of speed,
    acceleration and jerk."""
    dice = random.Random(robot)
    arm = arm_of(robot)
    fci = 5 if robot == "panda" else 10
    wire, heartbeat = pair()
    cycle, controller = Cycle(p.DIALECTS[fci], limits_of(arm, 0.2), heartbeat), Controller(arm, fci)
    assert controller.start(1, p.Controller.JOINT_IMPEDANCE, p.Generator.JOINT_POSITION - 1) == "motion_started"
    goals = [tuple(rad + far for rad in HOME_RAD) for far in (0.3, -0.3)]
    gaps = number = 0
    missing = 0
    for ms in range(1, 20_000):
        if ms % 300 == 1:
            number += 1
            cycle.obey(Order(number, goals[number % 2]).pack())
        wire.beat(ms * MS)
        if not missing and not dice.randrange(100):
            missing, gaps = dice.randint(1, 3), gaps + 1
        state, lost = controller.state(), missing > 0
        missing -= lost
        if not lost or late:
            answer = cycle.answer(state, ms * MS)
            if answer is not None and not lost:
                assert controller.take(controller.dialect.command(answer))
        assert controller.tick() is None, controller.reasons
        moving = max(map(abs, controller.dialect.get(controller.state(), "dq_d")))
        assert moving <= max(arm.speed) * 0.2 * 1.2
    assert gaps > 100 and 0 < cycle.times_continued < gaps, (
        "at a constant speed the missing commands need no correction"
    )
    for _ in range(3000):
        if controller.motion is None:
            break
        wire.beat(30_000 * MS)
        answer = cycle.answer(controller.state(), 30_000 * MS)
        assert answer is not None
        controller.take(controller.dialect.command(answer))
        ended = controller.tick()
    assert ended == (1, "success")
    assert controller.q_d == pytest.approx(goals[number % 2], abs=1e-6)

"""Test the client's side of a session: the answer to each message, cycle by cycle."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from strands_actors.drivers.kuka.protocol import COUNTER, JOINTS, Monitoring, State
from strands_actors.drivers.kuka.robots import arm_of
from strands_actors.drivers.kuka.session import LIVE_RAD, FriSession

SPEED = arm_of("kuka_iiwa").speed_rad_s
HERE = (0.1, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0)
Row = tuple[float, ...]


def off(position: Row, joint: int, rad: float) -> Row:
    return (*position[:joint], position[joint] + rad, *position[joint + 1 :])


class Controller:
    """The messages of an active session. Its controller accepts every answer that arrives."""

    def __init__(self, sample_ms: int = 5, state: int = State.COMMANDING_ACTIVE, sequence: int = 0) -> None:
        self.session = FriSession(SPEED)
        self.said = Monitoring(sequence, commanded=HERE, interpolated=HERE, state=state, sample_ms=sample_ms)

    def cycle(self, arrives: bool = True) -> Row:
        """Exchange one message and its answer. Return the answered position."""
        answer = self.session.answer(self.said)
        assert answer.reflected == self.said.sequence
        self.said = replace(self.said, sequence=(self.said.sequence + 1) & COUNTER)
        if arrives:
            taken = answer.position or self.said.commanded
            self.said = replace(self.said, reflected=answer.sequence, commanded=taken)
        return answer.position

    def enter(self, state: int) -> None:
        self.said = replace(self.said, state=state)


@pytest.mark.parametrize("state", [State.IDLE, State.MONITORING_WAIT, State.MONITORING_READY, 9])
def test_a_controller_that_only_monitors_is_answered_without_positions(state: int) -> None:
    controller = Controller(state=state)
    assert [controller.cycle() for _ in range(3)] == [()] * 3


def test_saf_011_the_first_command_is_the_mirrored_position() -> None:
    controller = Controller(state=State.COMMANDING_WAIT)
    mirrored = [controller.cycle() for _ in range(20)]
    controller.enter(State.COMMANDING_ACTIVE)
    controller.said = replace(controller.said, position=off(HERE, 0, 0.01))  # a measured position is no command
    assert {*mirrored, controller.cycle(), controller.cycle()} == {HERE}


def test_saf_011_a_client_that_joins_an_active_session_holds_the_controllers_position() -> None:
    assert Controller().cycle() == HERE


def test_a_hold_repeats_the_answer_to_the_last_bit() -> None:
    controller = Controller()
    controller.session.aim(off(HERE, 0, 0.02), 0.02)
    moved = controller.cycle()
    controller.session.hold()
    assert {controller.cycle() for _ in range(100)} == {moved}
    assert moved != HERE


@pytest.mark.parametrize("sample_ms", [2, 5, 10])
def test_a_step_is_spread_over_its_period(sample_ms: int) -> None:
    controller = Controller(sample_ms)
    controller.session.aim(off(off(HERE, 0, 0.02), 3, -0.01), 0.02)
    cycles = 20 // sample_ms
    rows = [HERE, *(controller.cycle() for _ in range(cycles))]
    assert rows[-1] == pytest.approx(off(off(HERE, 0, 0.02), 3, -0.01), abs=1e-9)
    steps = [later[0] - earlier[0] for earlier, later in itertools.pairwise(rows)]
    assert steps == pytest.approx([0.02 / cycles] * cycles, abs=1e-9)


@pytest.mark.parametrize("sample_ms", [2, 5, 10])
def test_no_cycle_steps_further_than_the_joint_turns_in_it(sample_ms: int) -> None:
    """The step limit holds however far the goal is, and however short its period."""
    controller = Controller(sample_ms)
    controller.session.aim((1.0,) * JOINTS, 0.001)
    before = HERE
    for _ in range(1000):
        after = controller.cycle()
        for was, now, speed in zip(before, after, SPEED, strict=True):
            assert abs(now - was) <= speed * sample_ms / 1e3 + 5 * LIVE_RAD
        before = after
    assert before == pytest.approx((1.0,) * JOINTS, abs=1e-9)


def test_while_a_setpoint_lives_no_two_answers_are_alike_and_the_arm_stays() -> None:
    controller = Controller()
    controller.session.aim(HERE, 0.02)
    rows = [controller.cycle() for _ in range(10_000)]
    assert all(earlier != later for earlier, later in itertools.pairwise(rows))
    assert max(abs(rad - to) for row in rows for rad, to in zip(row, HERE, strict=True)) <= 4 * LIVE_RAD


@given(st.lists(st.booleans(), min_size=2, max_size=60), st.sampled_from([0.0, 0.02, 1.0]))
def test_received_answers_also_differ_when_some_are_lost_or_late(taken: list[bool], way: float) -> None:
    """The controller has taken the previous answer, or only an older one. The answer to a setpoint never looks
    like a hold."""
    controller = Controller()
    controller.session.aim(off(HERE, 0, way), 0.02)
    before = HERE
    for arrives in taken:
        has = controller.said.commanded
        after = controller.cycle(arrives)
        assert after not in (before, has)
        before = after


def test_the_same_goal_again_changes_nothing() -> None:
    """A re-send does not spread the step again. It was spread when it was given."""
    once, again = Controller(), Controller()
    goal = off(HERE, 0, 0.02)
    once.session.aim(goal, 0.02)
    rows = []
    for _ in range(4):
        again.session.aim(goal, 0.02)
        rows.append(again.cycle())
    assert rows == [once.cycle() for _ in range(4)]


@given(st.lists(st.booleans(), min_size=1, max_size=120), st.sampled_from([2, 5, 10]))
def test_of_answers_that_are_lost_no_jump_comes(arrived: list[bool], sample_ms: int) -> None:
    """Between two answers that the controller takes lies at most one cycle's step, also for a hold."""
    controller = Controller(sample_ms)
    controller.session.aim((2.0,) * JOINTS, 0.02)
    for number, arrives in enumerate(arrived):
        if number == len(arrived) // 2:
            controller.session.hold()
        before = controller.said.commanded
        controller.cycle(arrives)
        for was, now, speed in zip(before, controller.said.commanded, SPEED, strict=True):
            assert abs(now - was) <= speed * sample_ms / 1e3 + 5 * LIVE_RAD


@pytest.mark.parametrize("state", [State.MONITORING_WAIT, State.MONITORING_READY, State.COMMANDING_WAIT])
def test_saf_008_a_goal_does_not_outlive_its_session(state: State) -> None:
    controller = Controller()
    controller.session.aim(off(HERE, 0, 1.0), 0.02)
    moved = controller.cycle()
    controller.said = replace(controller.said, interpolated=moved)
    controller.enter(state)
    controller.cycle()
    controller.enter(State.COMMANDING_ACTIVE)
    assert {controller.cycle() for _ in range(10)} == {moved}
    assert not controller.session.has_goal


def test_a_message_that_comes_twice_or_late_is_not_answered_and_a_new_session_is() -> None:
    controller = Controller(sequence=500)
    said = controller.said
    controller.cycle()
    due = {ahead: controller.session.is_due(replace(said, sequence=500 + ahead)) for ahead in (-10, -1, 0, 1, 7)}
    assert due == {-10: False, -1: False, 0: False, 1: True, 7: True}
    assert controller.session.is_due(replace(said, sequence=0))


def test_sequence_numbers_wrap() -> None:
    controller = Controller(sequence=COUNTER)
    controller.said = replace(controller.said, reflected=COUNTER)
    answer = controller.session.answer(controller.said)
    assert (answer.sequence, answer.reflected) == (0, COUNTER)
    assert controller.session.is_due(replace(controller.said, sequence=0))


def test_a_receive_multiplier_is_answered_every_so_many_messages() -> None:
    session = FriSession(SPEED)
    answered = []
    for sequence in range(9):
        said = Monitoring(sequence, commanded=HERE, state=State.COMMANDING_ACTIVE, sample_ms=2, multiplier=3)
        if session.is_due(said):
            session.answer(said)
            answered.append(sequence)
    assert answered == [0, 3, 6]


def test_sequence_numbers_continue_from_the_last_accepted_answer() -> None:
    """The stop channel takes over in this way: it reads the sequence from the messages."""
    controller = Controller()
    controller.said = replace(controller.said, reflected=41)
    assert controller.session.answer(controller.said).sequence == 42


def test_an_unrequested_hold_also_ends_the_motion() -> None:
    controller = Controller()
    controller.session.aim(off(HERE, 0, 1.0), 0.02)
    said, moved = controller.said, controller.cycle()
    unasked = controller.session.again(said)
    assert (unasked.position, unasked.reflected) == (moved, said.sequence)
    assert not controller.session.has_goal
    assert math.isclose(moved[0], HERE[0] + SPEED[0] * 0.005)


def test_saf_022_an_old_message_is_not_new_but_a_running_new_session_is() -> None:
    session = FriSession(SPEED)
    said = Monitoring(500, commanded=HERE, state=State.COMMANDING_ACTIVE, sample_ms=5)
    monitoring = replace(said, state=State.MONITORING_WAIT)

    def news(said: Monitoring, *sequences: int) -> list[bool]:
        return [session.accept(replace(said, sequence=sequence)) for sequence in sequences]

    assert news(said, 500, 500, 495, 510, 509) == [True, False, False, True, False]
    assert not any(news(said, 3, 4, 5, 6)), "a new session does not start in a commanding state"
    assert not any(news(monitoring, 3, 80, 7, 8, 30)), "old messages in any order are no new session"
    assert not any(news(said, 600, 700)), "a message that is far ahead is no new session"
    assert news(monitoring, 3, 4, 5, 6) == [False, False, True, True]
    assert news(monitoring, 100, 101, 102) == [False, False, True], (
        "messages that arrive late in order are a new session"
    )


def test_saf_022_a_hold_keeps_its_position_for_any_reported_command() -> None:
    controller = Controller()
    controller.session.aim(off(HERE, 0, 0.5), 0.02)
    moved = [controller.cycle() for _ in range(10)][-1]
    controller.session.hold()
    for reflected in (controller.said.reflected, 77, 1 << 20):
        controller.said = replace(controller.said, commanded=off(HERE, 3, 1.0), reflected=reflected)
        assert controller.cycle(arrives=False) == moved


def test_saf_022_a_number_that_was_not_sent_by_then_is_no_acknowledgement() -> None:
    controller = Controller()
    session = controller.session
    for _ in range(5):
        session.accept(controller.said)
        controller.cycle()
    hold = session.next_number(controller.said)
    forged = replace(controller.said, reflected=hold)
    session.accept(forged)
    session.answer(forged)
    assert not session.has_received_answer(forged, hold)
    session.accept(replace(forged, sequence=forged.sequence + 1))
    assert session.has_received_answer(forged, hold)

"""Test the actions of the simulated base: what the body does, and which events the client gets."""

from __future__ import annotations

import math

import numpy as np
import pytest

from .kortex_client import Fields, blob, inside, messages, number, read, real, whole
from .world import (
    ABORT,
    ACTION_TOPIC,
    CLEAR_FAULTS,
    END,
    EXECUTE_ACTION,
    EXECUTE_REFERENCE,
    HOME,
    PREPROCESS_ABORT,
    PREPROCESS_END,
    PREPROCESS_START,
    START,
    STOP,
    STOP_ACTION,
    World,
    angles,
    near,
    numbers,
    reach_angles,
    reach_pose,
    twist,
)

CREATE, READ, READ_ALL, DELETE = 0x2002A, 0x2002B, 0x2002C, 0x2002D
PLAY_JOINTS, PLAY_POSE, UNSUBSCRIBE = 0x2007C, 0x2006D, 0x20061
REACH_JOINT_ANGLES = 7
PLANNED = [PREPROCESS_START, PREPROCESS_END, START, END]
AWAY = (20.0, 30.0, 160.0, 250.0, 340.0, 40.0, 100.0)


@pytest.fixture
def world() -> World:
    made = World()
    made.watch_actions()
    return made


def actions(world: World, kind: int = 0) -> dict[str, Fields]:
    found: dict[str, Fields] = {}
    for action in messages(world.call(READ_ALL, number(1, kind)), 1):
        name = action[2][0]
        assert isinstance(name, bytes)
        found[name.decode()] = action
    return found


def handle(action: Fields) -> bytes:
    value = action[1][0]
    assert isinstance(value, bytes)
    return value


def test_home_is_found_among_the_actions_and_reached(world: World) -> None:
    stored = actions(world, REACH_JOINT_ANGLES)
    assert list(stored) == ["Retract", "Home", "Zero"]
    assert whole(read(handle(stored["Home"])), 1) == 2
    world.call(EXECUTE_ACTION, reach_angles(AWAY))
    world.finish()
    assert near(world.degrees(), AWAY)
    world.notifications.clear()
    world.call(EXECUTE_REFERENCE, handle(stored["Home"]))
    assert world.finish() == PLANNED
    assert near(world.degrees(), HOME)
    assert whole(inside(read(world.notifications[-1].payload), 2), 1) == 2, "the event names the action"


@pytest.mark.parametrize("name", ["Retract", "Zero"])
def test_the_other_predefined_actions_are_reached(world: World, name: str) -> None:
    goal = {"Retract": (0, 340, 180, 214, 0, 310, 90), "Zero": (0,) * 7}[name]
    world.call(EXECUTE_REFERENCE, handle(actions(world)[name]))
    assert world.finish() == PLANNED
    assert near(world.degrees(), goal)


def test_a_joint_without_limits_turns_the_short_way(world: World) -> None:
    world.call(EXECUTE_ACTION, reach_angles((350.0, *HOME[1:])))
    farthest = 0.0

    def look() -> None:
        nonlocal farthest
        farthest = max(farthest, abs(world.base.plant.position_rad[0]))

    world.run(3.0, look)
    assert world.finish()[-1] == END and near(world.degrees(), (350.0, *HOME[1:]))
    assert farthest < math.radians(11.0)


def test_the_order_of_angles_counts_as_the_vendors_sequence_has_no_identifiers(world: World) -> None:
    world.call(PLAY_JOINTS, blob(1, angles(AWAY, identifiers=False)))
    assert world.finish() == PLANNED
    assert near(world.degrees(), AWAY)


def test_the_tool_moves_on_a_line(world: World) -> None:
    start = world.pose()
    goal = [start[0], start[1] - 0.1, start[2] - 0.2, *start[3:]]
    world.call(EXECUTE_ACTION, reach_pose(goal))
    way = np.array(goal[:3]) - np.array(start[:3])
    off_m = []

    def look() -> None:
        moved = world.tool_m() - np.array(start[:3])
        off_m.append(np.linalg.norm(moved - way * (moved @ way) / (way @ way)))

    world.run(2.0, look)
    assert world.finish() == PLANNED
    assert np.allclose(world.tool_m(), goal[:3], atol=2e-3)
    assert near(world.pose()[3:], goal[3:])
    assert max(off_m) < 5e-3


def test_a_pose_is_played_at_the_speed_of_its_constraint(world: World) -> None:
    x, *rest = world.pose()
    world.call(PLAY_POSE, blob(1, numbers([x - 0.1, *rest])) + blob(2, blob(1, real(1, 0.05) + real(2, 10.0))))
    speeds = []
    world.run(1.0, lambda: speeds.append(math.hypot(*(world.of_base(field) for field in (19, 20, 21)))))
    assert max(speeds) == pytest.approx(0.05, abs=0.01)
    assert world.finish()[-1] == END and world.pose()[0] == pytest.approx(x - 0.1, abs=2e-3)


@pytest.mark.parametrize(
    ("action", "details"),
    [
        (reach_pose((1.5, 0.0, 0.4, 90.0, 0.0, 90.0)), 56),
        (reach_angles((0.0, 140.0, *HOME[2:])), 65),
        (reach_angles((0.0,) * 6), 57),
        (reach_angles((180.0, *HOME[1:]), number(1, 1) + real(2, 0.5)), 58),
        (reach_angles((180.0, *HOME[1:]), number(1, 2) + real(2, 200.0)), 60),
        (reach_pose((0.5, 0.0, 0.4, 90.0, 0.0, 90.0), blob(1, real(1, -0.1))), 59),
    ],
)
def test_a_plan_that_the_arm_cannot_carry_out_is_aborted_with_the_reason(
    world: World, action: bytes, details: int
) -> None:
    world.call(EXECUTE_ACTION, action)
    assert world.events() == [PREPROCESS_START, PREPROCESS_ABORT, ABORT]
    assert world.abort_details == details
    world.run(1.0)
    assert near(world.degrees(), HOME)


@pytest.mark.parametrize(
    ("constraint", "error"), [(number(1, 1) + real(2, 0.0), (3, 58)), (number(1, 2) + real(2, -1.0), (3, 59))]
)
def test_a_constraint_that_is_none_is_refused(world: World, constraint: bytes, error: tuple[int, int]) -> None:
    assert world.refusal(EXECUTE_ACTION, reach_angles(AWAY, constraint)) == error
    assert world.events() == []


def test_a_duration_is_kept(world: World) -> None:
    world.call(EXECUTE_ACTION, reach_angles((10.0, *HOME[1:]), number(1, 1) + real(2, 5.0)))
    world.run(4.9)
    assert world.events()[-1] == START
    world.run(0.3)
    assert world.events()[-1] == END


@pytest.mark.parametrize("how", [STOP, STOP_ACTION])
def test_a_stop_aborts_the_action_and_the_arm_stands(world: World, how: int) -> None:
    world.call(EXECUTE_ACTION, reach_angles(AWAY))
    world.run(1.0)
    world.call(how)
    assert (world.events()[-1], world.abort_details) == (ABORT, 55)
    world.run(0.5)
    here = world.degrees()
    assert not near(here, HOME, 2.0) and not near(here, AWAY, 2.0)
    world.run(1.0)
    assert near(world.degrees(), here, 0.01)


def test_without_an_action_none_can_be_stopped(world: World) -> None:
    assert world.refusal(STOP_ACTION) == (3, 73)
    assert world.refusal(STOP) == (0, 0)


def test_a_new_command_aborts_the_running_action(world: World) -> None:
    world.call(EXECUTE_ACTION, reach_angles(AWAY))
    world.run(1.0)
    world.call(EXECUTE_ACTION, reach_angles(HOME))
    assert world.events() == [*PLANNED[:3], ABORT, *PLANNED[:3]]
    world.finish()
    assert near(world.degrees(), HOME)


def test_a_stuck_joint_aborts_the_action(world: World) -> None:
    world.base.plant.set_stuck(0, True)
    world.call(EXECUTE_ACTION, reach_angles((10.0, *HOME[1:])))
    assert (world.finish()[-1], world.abort_details) == (ABORT, 1)


@pytest.mark.parametrize("field", [5, 16, 17, 19, 20, 21, 25, 26, 28, 37, 39, 40])
def test_an_action_of_another_type_is_refused_by_the_device(world: World, field: int) -> None:
    parameters = number(field, 1) if field in (16, 20, 21) else blob(field, b"")
    assert world.refusal(EXECUTE_ACTION, parameters) == (3, 46)
    assert world.refusal(CREATE, parameters) == (3, 46)
    assert world.events() == []


def test_an_action_without_parameters_is_refused(world: World) -> None:
    assert world.refusal(EXECUTE_ACTION, blob(2, b"nothing")) == (3, 3)


def test_in_a_fault_or_in_low_level_servoing_no_action_begins(world: World) -> None:
    world.set_mode(3)
    assert world.refusal(EXECUTE_ACTION, reach_angles(AWAY)) == (3, 75)
    assert world.state() == 6
    world.set_mode(2)
    world.call(EXECUTE_ACTION, blob(31, b""))
    assert (world.events()[-1], world.state(), world.faults()[0]) == (END, 4, 0x800000)
    assert world.refusal(EXECUTE_ACTION, reach_angles(AWAY)) == (3, 22)
    world.call(EXECUTE_ACTION, blob(32, b""))
    assert (world.state(), world.faults()[0]) == (7, 0)


def test_a_fault_aborts_the_action(world: World) -> None:
    world.call(EXECUTE_ACTION, reach_angles(AWAY))
    world.run(1.0)
    world.call(0x20091)
    assert (world.events()[-1], world.abort_details) == (ABORT, 22)
    world.call(CLEAR_FAULTS)
    assert world.state() == 7


def test_a_delay_takes_its_time(world: World) -> None:
    world.call(EXECUTE_ACTION, blob(34, number(1, 2)))
    world.run(1.9)
    assert world.events() == [START]
    world.run(0.2)
    assert world.events() == [START, END]


def test_a_velocity_of_an_action_lasts_until_it_is_stopped(world: World) -> None:
    world.call(EXECUTE_ACTION, blob(4, twist((-0.05, 0, 0, 0, 0, 0), 3)))
    start = world.tool_m()
    world.run(2.0)
    assert world.events() == [START]
    assert (world.tool_m() - start)[0] == pytest.approx(-0.1, abs=0.01)
    world.call(EXECUTE_ACTION, blob(38, b""))
    assert world.events() == [START, ABORT, START, END]
    world.run(0.5)
    here = world.tool_m()
    world.run(0.5)
    assert np.allclose(world.tool_m(), here, atol=1e-4)


def test_clients_may_store_actions_but_not_delete_those_of_the_base(world: World) -> None:
    created = world.call(CREATE, reach_angles(AWAY))
    number_of = whole(created, 1)
    assert list(actions(world)) == ["Retract", "Home", "Zero", "an action"]
    assert whole(inside(world.call(READ, number(1, number_of)), 1), 1) == number_of
    world.call(EXECUTE_ACTION, blob(35, number(1, number_of)))
    assert world.finish() == PLANNED and near(world.degrees(), AWAY)
    world.call(DELETE, number(1, number_of))
    assert world.refusal(READ, number(1, number_of)) == (3, 17)
    assert world.refusal(DELETE, number(1, 2)) == (3, 40)
    assert world.refusal(EXECUTE_REFERENCE, number(1, number_of)) == (3, 17)


def test_no_event_follows_the_end_of_a_subscription(world: World) -> None:
    (first,) = (whole(world.call(ACTION_TOPIC), 1) for _ in range(1))
    world.call(EXECUTE_ACTION, blob(34, number(1, 1)))
    assert [frame.message for frame in world.notifications] == [1, first]
    world.call(UNSUBSCRIBE, number(1, first))
    world.run(1.5)
    assert [frame.message for frame in world.notifications] == [1, first, 1]
    assert world.refusal(UNSUBSCRIBE, number(1, first)) == (3, 17)
    world.call(0x10002)
    world.base.actions.execute(world.base.actions.store.get(2))
    assert len(world.notifications) == 3

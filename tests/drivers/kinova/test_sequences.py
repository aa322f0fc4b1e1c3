"""Test sequences and waypoints on the simulated base, as the vendor's examples use them."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
import pytest

from .kortex_client import blob, inside, messages, number, read, real, whole
from .world import (
    ABORT,
    END,
    EXECUTE_ACTION,
    HOME,
    SEQUENCE_TOPIC,
    STOP,
    World,
    near,
    numbers,
    reach_angles,
    reach_pose,
)

CREATE, READ_SEQUENCE, DELETE, READ_ALL, PLAY, STOP_SEQUENCE = 0x20008, 0x2000A, 0x2000B, 0x2000C, 0x2000F, 0x20011
VALIDATE, EXECUTE_WAYPOINTS = 0x200EB, 0x200E2
COMPLETED, ABORTED, TASK_STARTED, TASK_COMPLETED, STARTED = 1, 2, 4, 5, 6
PLAYING_SEQUENCE = 8
AWAY = (10.0, 20.0, 170.0, 240.0, 350.0, 50.0, 95.0)


def sequence(*actions: bytes) -> bytes:
    tasks = (number(1, group) + blob(2, action) for group, action in enumerate(actions))
    return blob(2, b"a sequence") + b"".join(blob(4, task) for task in tasks)


def finish(world: World) -> list[int]:
    for _ in range(600):
        if {COMPLETED, ABORTED} & set(world.events(SEQUENCE_TOPIC)[-1:]):
            return world.events(SEQUENCE_TOPIC)
        world.run(0.1)
    raise AssertionError(world.events(SEQUENCE_TOPIC))


def details(world: World) -> tuple[int, int]:
    """Return the index of the task and the sub-error of the last event."""
    last = read([frame for frame in world.notifications if frame.call == SEQUENCE_TOPIC][-1].payload)
    return whole(last, 3), whole(last, 7)


def test_the_actions_of_a_sequence_are_carried_out_one_after_the_other() -> None:
    world = World()
    world.call(SEQUENCE_TOPIC)
    start = world.pose()
    goal = [start[0], start[1] - 0.05, start[2] - 0.1, *start[3:]]
    created = world.call(CREATE, sequence(reach_pose(goal), blob(34, number(1, 1)), reach_angles(AWAY)))
    world.call(PLAY, number(1, whole(created, 1)))
    assert world.state() == PLAYING_SEQUENCE
    for _ in range(400):
        if world.events(SEQUENCE_TOPIC).count(TASK_COMPLETED):
            break
        world.run(0.05)
    assert np.allclose(world.tool_m(), goal[:3], atol=2e-3)
    task = [TASK_STARTED, TASK_COMPLETED]
    assert finish(world) == [STARTED, *task * 3, COMPLETED]
    assert near(world.degrees(), AWAY) and world.state() == 7
    assert details(world) == (2, 0)


def test_a_stop_aborts_the_sequence_with_the_action() -> None:
    world = World()
    world.call(SEQUENCE_TOPIC)
    world.watch_actions()
    handle = number(1, whole(world.call(CREATE, sequence(reach_angles(AWAY), reach_angles(HOME))), 1))
    for stop in (STOP, STOP_SEQUENCE):
        world.notifications.clear()
        world.call(PLAY, handle)
        world.run(0.5)
        world.call(stop)
        assert world.events(SEQUENCE_TOPIC) == [STARTED, TASK_STARTED, ABORTED]
        assert (details(world), world.events()[-1], world.state()) == ((0, 55), ABORT, 7)
    assert world.refusal(STOP_SEQUENCE) == (3, 73)


def test_no_other_command_moves_the_arm_during_a_sequence() -> None:
    world = World()
    handle = number(1, whole(world.call(CREATE, sequence(reach_angles(AWAY))), 1))
    world.call(PLAY, handle)
    assert world.refusal(0x20084, b"") == (3, 18)
    assert world.refusal(EXECUTE_ACTION, reach_angles(HOME)) == (3, 18)
    assert world.refusal(PLAY, handle) == (3, 18)


@pytest.mark.parametrize(("second", "sub"), [(blob(31, b""), 22), (reach_pose((2.0, 0, 0, 0, 0, 0)), 56)])
def test_a_task_that_fails_aborts_the_sequence(second: bytes, sub: int) -> None:
    world = World()
    world.call(SEQUENCE_TOPIC)
    created = world.call(CREATE, sequence(blob(34, number(1, 1)), second, reach_angles(AWAY)))
    world.call(PLAY, number(1, whole(created, 1)))
    assert finish(world)[-1] == ABORTED
    assert details(world)[1] == sub
    world.run(1.0)
    assert near(world.degrees(), HOME)


def test_sequences_are_stored_read_and_deleted() -> None:
    world = World()
    assert world.refusal(CREATE, blob(2, b"empty")) == (3, 3)
    assert world.refusal(CREATE, sequence(blob(17, b""))) == (3, 46)
    handle = number(1, whole(world.call(CREATE, sequence(reach_angles(AWAY))), 1))
    assert world.call(READ_SEQUENCE, handle)[2] == [b"a sequence"]
    assert len(messages(world.call(READ_ALL), 1)) == 1
    world.call(DELETE, handle)
    for function in (READ_SEQUENCE, DELETE, PLAY):
        assert world.refusal(function, handle) == (3, 17)


# -- waypoints


def angular(degrees: Sequence[float], duration_s: float = 0.0, packed: bool = True) -> bytes:
    data = struct.pack(f"<{len(degrees)}f", *degrees)
    floats = blob(1, data) if packed else b"".join(real(1, value) for value in degrees)
    return blob(2, floats + real(3, duration_s))


def cartesian(pose: Sequence[float], radius: float = 0.0, frame: int = 3) -> bytes:
    return blob(3, blob(1, numbers(pose)) + number(2, frame) + real(5, radius))


def waypoints(*each: bytes, duration_s: float = 0.0, optimal: int = 0) -> bytes:
    return b"".join(blob(1, one) for one in each) + real(2, duration_s) + number(3, optimal)


def errors(world: World, payload: bytes) -> list[tuple[int, int]]:
    """Return the type and the waypoint of each error."""
    report = inside(world.call(VALIDATE, payload), 1)
    return [(whole(each, 1), whole(each, 8)) for each in messages(report, 1)]


def passes(world: World, goals: Sequence[Sequence[float]], of: str, within: float) -> list[int]:
    """Return the goals that the arm passes, in order, until the action has ended."""
    passed: list[int] = []

    def look() -> None:
        here = world.tool_m() if of == "tool" else np.array(world.degrees())
        index = len(passed)
        if index < len(goals):
            off = here - np.array(goals[index])
            off = off if of == "tool" else (off + 180.0) % 360.0 - 180.0
            if np.abs(off).max() < within:
                passed.append(index)

    for _ in range(1200):
        world.run(0.1, look)
        if {END, ABORT} & set(world.events()):
            return passed
    raise AssertionError(passed)


@pytest.mark.parametrize("packed", [True, False])
def test_the_arm_moves_through_angular_waypoints(packed: bool) -> None:
    world = World()
    world.watch_actions()
    goals = [(360.0, 35.6, 180.7, 281.8, 0.8, 23.8, 88.9), AWAY, HOME]
    payload = waypoints(*(angular(goal, 5.0, packed) for goal in goals))
    assert errors(world, payload) == []
    world.call(EXECUTE_WAYPOINTS, payload)
    assert passes(world, goals, "joints", 0.5) == [0, 1, 2]
    assert world.events()[-1] == END and near(world.degrees(), HOME)


@pytest.mark.parametrize("optimal", [0, 1])
def test_the_tool_moves_through_cartesian_waypoints(optimal: int) -> None:
    world = World()
    world.watch_actions()
    turn = (90.0, 0.0, 90.0)
    places = [(0.7, 0.0, 0.5), (0.7, 0.0, 0.33), (0.7, 0.3, 0.33), (0.61, 0.1, 0.4)]
    world.call(
        EXECUTE_WAYPOINTS,
        waypoints(
            *(cartesian((*place, *turn), 0.1 * (at in (1, 2))) for at, place in enumerate(places)), optimal=optimal
        ),
    )
    assert passes(world, places, "tool", 5e-3) == [0, 1, 2, 3]
    assert world.events()[-1] == END


@pytest.mark.parametrize(
    ("payload", "error"),
    [
        (waypoints(), (9, 0)),
        (waypoints(angular(AWAY), cartesian((0.5, 0, 0.4, 90, 0, 90))), (25, 0)),
        (waypoints(angular(AWAY), angular(AWAY[:6])), (2, 1)),
        (waypoints(angular(AWAY), angular((0, 150, *HOME[2:]))), (11, 1)),
        (waypoints(angular(AWAY, 0.1)), (3, 0)),
        (waypoints(angular(AWAY), duration_s=0.1), (3, 0)),
        (waypoints(cartesian((0.5, 0, 0.4, 90, 0, 90)), cartesian((3, 0, 0, 90, 0, 90))), (1, 1)),
        (waypoints(cartesian((0.5, 0, 0.4, 90, 0, 90), radius=0.1)), (27, 0)),
        (waypoints(cartesian((0.5, 0, 0.4, 90, 0, 90), radius=-0.1)), (28, 0)),
        (waypoints(cartesian((0.5, 0, 0.4, 90, 0, 90), frame=2)), (29, 0)),
    ],
)
def test_waypoints_that_the_arm_cannot_follow_are_reported_and_aborted(
    payload: bytes, error: tuple[int, int]
) -> None:
    world = World()
    world.watch_actions()
    assert errors(world, payload) == [error]
    world.call(EXECUTE_WAYPOINTS, payload)
    assert world.events()[-1] == ABORT and world.abort_details
    world.run(0.5)
    assert near(world.degrees(), HOME)


def test_optimal_blending_is_not_computed() -> None:
    assert World().refusal(VALIDATE, waypoints(angular(AWAY), optimal=1)) == (3, 46)

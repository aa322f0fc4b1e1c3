"""Test the gripper of the simulated base, as the vendor's example uses it."""

from __future__ import annotations

import pytest

from .kortex_client import blob, inside, messages, number, real, real_of
from .world import EXECUTE_ACTION, FEEDBACK, START, STOP, World

SEND, MEASURED = 0x20088, 0x20089
FORCE, SPEED, POSITION = 1, 2, 3


def command(mode: int, value: float, duration: int = 0) -> bytes:
    return number(1, mode) + blob(2, blob(1, number(1, 1) + real(2, value))) + number(3, duration)


def measured(world: World, mode: int) -> float:
    (finger,) = messages(world.call(MEASURED, number(1, mode)), 1)
    return real_of(finger, 2)


def test_the_fingers_go_to_positions_and_are_measured() -> None:
    world = World()
    for position in (0.3, 0.9, 0.0):
        world.call(SEND, command(POSITION, position))
        world.run(0.05)
        assert abs(measured(world, SPEED)) == 1.0
        world.run(1.0)
        assert measured(world, POSITION) == pytest.approx(position)
        assert measured(world, SPEED) == 0.0


def test_a_positive_speed_opens_and_a_negative_one_closes() -> None:
    world = World()
    world.call(SEND, command(POSITION, 1.0))
    world.run(1.0)
    world.call(SEND, command(SPEED, 0.1))
    world.run(1.0)
    assert measured(world, SPEED) == pytest.approx(0.1)
    assert measured(world, POSITION) == pytest.approx(1.0 - 0.1 * 0.15 / 0.085, abs=0.01)
    world.run(6.0)
    assert (measured(world, POSITION), measured(world, SPEED)) == (0.0, 0.0)
    world.call(SEND, command(SPEED, -0.1))
    world.run(0.5)
    assert measured(world, SPEED) == pytest.approx(-0.1)
    world.call(STOP)
    here = measured(world, POSITION)
    world.run(1.0)
    assert measured(world, POSITION) == here > 0.0


def test_a_duration_ends_the_motion() -> None:
    world = World()
    world.call(SEND, command(SPEED, -0.1, duration=2))
    world.run(4.0)
    assert measured(world, POSITION) == pytest.approx(2.0 * 0.1 * 0.15 / 0.085, abs=0.01)


@pytest.mark.parametrize(
    ("payload", "sub"),
    [
        (command(FORCE, 0.5), 3),
        (command(POSITION, 1.2), 48),
        (command(POSITION, -0.1), 49),
        (command(SPEED, -1.2), 49),
        (number(1, POSITION), 3),
    ],
)
def test_what_the_gripper_does_not_have_is_refused(payload: bytes, sub: int) -> None:
    world = World()
    assert world.refusal(SEND, payload) == (3, sub)
    world.run(0.5)
    assert measured(world, POSITION) == 0.0


def test_in_a_fault_the_gripper_does_not_move() -> None:
    world = World()
    world.call(0x20091)
    assert world.refusal(SEND, command(POSITION, 0.5)) == (3, 22)


def test_an_action_moves_it_and_has_no_event_at_its_end() -> None:
    world = World()
    world.watch_actions()
    world.call(EXECUTE_ACTION, blob(36, command(POSITION, 0.5)))
    world.run(1.0)
    assert measured(world, POSITION) == pytest.approx(0.5) and world.events() == [START]


def test_the_feedback_has_the_gripper_in_percent() -> None:
    world = World()
    world.call(SEND, command(POSITION, 0.4))
    world.run(1.0)
    motor = inside(world.call(FEEDBACK), 4, 18, 7)
    assert real_of(motor, 4) == pytest.approx(40.0)


def test_an_arm_without_a_gripper_has_no_finger() -> None:
    world = World(has_gripper=False)
    assert world.call(MEASURED, number(1, POSITION)) == {}
    assert world.refusal(SEND, command(POSITION, 0.5)) == (3, 50)
    assert world.refusal(EXECUTE_ACTION, blob(36, command(POSITION, 0.5))) == (3, 50)
    assert world.pose()[0] == pytest.approx(World().pose()[0] - 0.12, abs=1e-3), "the tool ends at the interface"

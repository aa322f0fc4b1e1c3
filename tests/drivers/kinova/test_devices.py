"""Test the devices, the users and the topics of the simulated base, as the vendor's examples use them."""

from __future__ import annotations

from typing import Any

import pytest

from .kortex_client import KortexError, blob, inside, messages, number, read, whole
from .world import ARM_STATE, CLEAR_FAULTS, CREATE_SESSION, SET_MODE, World

READ_ALL, PRODUCT = 0x170001, 0x200C6
TYPE, MAC, SERIAL = 0x90003, 0x90009, 0x90008
CREATE_USER, DELETE_USER, CHANGES = 0x20001, 0x20004, 0x20062
MODE_TOPIC, STATE_TOPIC, UNSUBSCRIBE = 0x2009A, 0x200B0, 0x20061


def test_all_devices_are_named_and_answer_by_their_numbers() -> None:
    world = World()
    devices = {whole(each, 2): whole(each, 1) for each in messages(world.call(READ_ALL), 1)}
    assert devices == {0: 1, **dict.fromkeys((1, 2, 3, 4), 3), **dict.fromkeys((5, 6, 7), 4), 9: 5, 10: 6}
    for device, kind in devices.items():
        assert world.call(TYPE, device=device)[1] == [kind]
    macs = {str(world.call(MAC, device=device)[1]) for device in devices}
    serials = {str(world.call(SERIAL, device=device)[1]) for device in devices}
    assert len(macs) == len(serials) == len(devices)
    assert world.refusal(TYPE, device=8) == (3, 52)


def test_without_a_gripper_none_is_named() -> None:
    world = World(has_gripper=False)
    assert 10 not in [whole(each, 2) for each in messages(world.call(READ_ALL), 1)]
    assert world.refusal(TYPE, device=10) == (3, 52)
    assert (world.call(PRODUCT)[8], World().call(PRODUCT)[8]) == ([1], [3])


def test_the_product_is_a_gen3_with_seven_joints() -> None:
    product = World().call(PRODUCT)
    assert (product[2], product[6]) == ([1], [7])


# -- users


def profile(name: str, password: str = "secret") -> bytes:
    return blob(1, blob(2, name.encode())) + blob(2, password.encode())


def log_in(world: World, name: str, password: str) -> None:
    world.call(
        CREATE_SESSION, blob(1, name.encode()) + number(2, 10**9) + blob(3, password.encode()) + number(4, 10**9)
    )


def test_a_new_user_may_open_a_session_until_deleted() -> None:
    world = World()
    handle = number(1, whole(world.call(CREATE_USER, profile("eve")), 1))
    log_in(world, "eve", "secret")
    with pytest.raises(KortexError) as failed:
        log_in(world, "eve", "guess")
    assert (failed.value.code, failed.value.sub) == (1, 15)
    world.call(DELETE_USER, handle)
    with pytest.raises(KortexError) as failed:
        log_in(world, "eve", "secret")
    assert (failed.value.code, failed.value.sub) == (1, 16)


def test_users_have_names_of_their_own() -> None:
    world = World()
    assert world.refusal(CREATE_USER, profile("")) == (3, 105)
    assert world.refusal(CREATE_USER, profile("admin")) == (3, 104)
    assert world.refusal(DELETE_USER, number(1, 1)) == (3, 40)
    assert world.refusal(DELETE_USER, number(1, 77)) == (3, 17)


# -- topics


def test_changes_are_notified_with_their_handles() -> None:
    world = World()
    subscription = whole(world.call(CHANGES), 1)
    number_of = whole(world.call(CREATE_USER, profile("eve")), 1)
    world.call(DELETE_USER, number(1, number_of))
    seen = [(whole(fields, 1), whole(inside(fields, 9), 1)) for fields in notified(world, CHANGES)]
    assert seen == [(4, number_of), (2, number_of)]
    assert {frame.message for frame in world.notifications} == {subscription}
    world.call(UNSUBSCRIBE, number(1, subscription))
    world.call(CREATE_USER, profile("eve"))
    assert len(notified(world, CHANGES)) == 2


def notified(world: World, topic: int) -> list[Any]:
    return [read(frame.payload) for frame in world.notifications if frame.call == topic]


def test_a_change_of_the_mode_and_of_the_state_is_notified() -> None:
    world = World()
    world.call(MODE_TOPIC)
    world.call(STATE_TOPIC)
    for mode in (3, 2):
        world.call(SET_MODE, number(1, mode))
    world.call(0x20091)
    world.call(CLEAR_FAULTS)
    assert [whole(each, 1) for each in notified(world, MODE_TOPIC)] == [3, 2]
    assert [whole(each, 1) for each in notified(world, STATE_TOPIC)] == [6, 7, 4, 7]
    assert whole(world.call(ARM_STATE), 1) == 7

"""Test that no twin says "done" without doing: what it does not model is answered with the vendor's own error.

The test walks all messages of each protocol on the twin. It fails if a twin accepts a message that is not in its
table, or if a message of the table has no effect that can be observed.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class, list_native_drivers
from strands_actors.drivers.common.twin.modelled import tables_of
from strands_actors.drivers.ur.twin import commands as c
from strands_actors.drivers.ur.twin.requests import COMMANDS, FUNCTIONS
from tests.drivers.modelled import (
    arms,
    can_motors,
    dds,
    fri,
    grpc_services,
    http_services,
    mobile,
    ur,
    ur_programs,
    ur_rtde,
)
from tests.drivers.modelled.walk import Walk, fingerprint

ROOMS = (arms, can_motors, dds, fri, grpc_services, http_services, mobile, ur, ur_programs, ur_rtde)
WALKS = [walk for room in ROOMS for walk in room.walks()]
WALKED = pytest.mark.parametrize("walk", WALKS, ids=lambda walk: walk.name)

ELSEWHERE = {
    "time during a motion",  # no message: tests/drivers/franka/test_pace.py
}
"""Titles of tables that no walk of this file uses."""


def warm_up(walk: Walk, twin: object) -> None:
    """Send a message that is not modelled, because the first message of all starts the clock of the physics."""
    other = next(key for key in walk.keys if key not in walk.table)
    for data in walk.others[:1]:
        walk.ask(twin, other, data)


@WALKED
def test_what_is_not_modelled_is_never_accepted_and_changes_nothing(walk: Walk) -> None:
    twin = walk.world()
    others = [key for key in walk.keys if key not in walk.table]
    warm_up(walk, twin)
    before = fingerprint(twin)
    for key in others:
        for data in walk.others:
            answer = walk.ask(twin, key, data)
            assert not answer.accepted, f"{walk.name} accepts {key!r} with {data!r}: {answer.content!r}"
    assert fingerprint(twin) == before


@WALKED
def test_what_is_modelled_has_an_effect(walk: Walk) -> None:
    assert set(walk.requests) == set(walk.table.effects), "each modelled message is tried"
    assert set(walk.table.effects) <= set(walk.keys), "each modelled message is one of the protocol"
    for key, data in walk.requests.items():
        twin = walk.world()
        walk.prepare.get(key, lambda twin: None)(twin)
        warm_up(walk, twin)
        before = fingerprint(twin)
        answer = walk.ask(twin, key, data)
        assert answer.accepted, f"{walk.name} refuses {key!r}, which is in its table"
        changed = bool(answer.content) or fingerprint(twin) != before
        assert changed or key in walk.without, f"{walk.name}: {key!r} is accepted without an effect"


def drivers() -> Iterator[tuple[str, type[Driver]]]:
    for robot in list_native_drivers():
        driver = get_native_driver_class(robot)
        if driver is not None and issubclass(driver, Driver) and driver.TWIN:
            yield robot, driver


def test_every_twin_says_what_it_models_and_every_table_is_walked() -> None:
    walked = {id(walk.table) for walk in WALKS}
    for robot, driver in drivers():
        tables = tables_of(driver.TWIN, robot)
        assert tables, f"the twin of {robot} does not say what it models"
        for table in tables:
            assert id(table) in walked or table.title in ELSEWHERE, f"{robot}: nothing walks {table.title!r}"
            assert table.otherwise and all(row.effect for row in table.rows())


def test_a_ur_program_has_the_functions_of_the_table_and_no_others() -> None:
    assert ur_programs.known_functions() == set(FUNCTIONS.effects)


def test_ur_rtdes_script_has_the_commands_of_the_table_and_no_others() -> None:
    assert {command for command in c.Command if command not in COMMANDS} == set()
    assert set(c.REFUSED).isdisjoint(COMMANDS.effects)

"""The readings of several leaders are one reading of a robot of parts."""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.teleoperation.sources import Leaders, Reading


class Still:
    """A leader that always gives the same reading, or is lost."""

    READINGS = 1

    def __init__(self, reading: Reading | None) -> None:
        self._reading = reading

    async def open(self) -> None:
        """Do nothing."""

    async def read(self) -> Reading:
        if self._reading is None:
            raise WireDown("lost")
        return self._reading

    def close(self) -> None:
        """Do nothing."""


async def _read(left: Reading | None, right: Reading | None) -> Reading:
    return await Leaders({"left_": Still(left), "right_": Still(right)}).read()


def test_a_reading_has_the_names_of_the_whole_robot_and_the_age_of_the_oldest_leader() -> None:
    reading = trio.run(_read, Reading(7, {"a": 1.0}), Reading(5, {"a": 2.0}))
    assert reading == Reading(5, {"left_a": 1.0, "right_a": 2.0})


def test_without_one_leader_there_is_no_reading() -> None:
    assert trio.run(_read, Reading(7, {"a": 1.0}), Reading(0, {})) == Reading(0, {})
    with pytest.raises(WireDown, match="lost"):
        trio.run(_read, Reading(7, {"a": 1.0}), None)

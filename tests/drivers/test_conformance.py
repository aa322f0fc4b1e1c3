"""Run the conformance checks of every driver, with the hardest kill cells on its twin. Drivers with all cells
in ``tests/kill`` skip their kill cells here."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class
from strands_actors.surfaces.cli.matrix import every_column
from strands_actors.testing import Check, conformance
from strands_actors.testing.checks import close_bench
from strands_actors.testing.registering import class_of, column
from tests.kill.test_kill import WHOLE


def quick(check: Check) -> bool:
    """Return True for all checks except kill cells. Of those, keep the one in which the stop channel acts."""
    return not check.name.startswith("kill cell") or check.name.endswith("wire-kill")


def checks() -> Iterator[object]:
    whole = {get_native_driver_class(robot) for robot in WHOLE}
    for name in every_column():
        robot, where = column(name)
        driver_class = class_of(where) or get_native_driver_class(robot)
        assert driver_class is not None and issubclass(driver_class, Driver)
        for check in conformance(driver_class, robot):
            if not (driver_class in whole and check.name.startswith("kill cell")):
                marks = () if quick(check) else (pytest.mark.long,)
                yield pytest.param(check, id=f"{name}-{check}", marks=marks)


@pytest.fixture(scope="module", autouse=True)
def benches() -> Iterator[None]:
    """Close this worker's bench, which stays open unless it ran the last cell of its driver."""
    yield
    close_bench()


@pytest.mark.parametrize("check", list(checks()))
def test_a_driver_conforms(check: Check) -> None:
    check()

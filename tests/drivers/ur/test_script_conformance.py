"""Run the conformance checks on a UR with our own control script, with the hardest kill cells on the twin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from strands_actors.drivers.ur.driver import UR
from strands_actors.testing import Check, conformance
from strands_actors.testing.checks import close_bench


class ScriptUR(UR):
    """A driver that uses the script unless an option selects something else."""

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return super().resolve(robot, {"control": "script", **options})


QUICK = tuple(f"kill cell {victim}-kill" for victim in ("caller", "wire", "root"))


def checks() -> Iterator[object]:
    for check in conformance(ScriptUR, "ur5e"):
        long = check.name.startswith("kill cell") and check.name not in QUICK
        yield pytest.param(check, id=str(check), marks=[pytest.mark.long] if long else [])


@pytest.fixture(scope="module", autouse=True)
def benches() -> Iterator[None]:
    yield
    close_bench()


@pytest.mark.parametrize("check", list(checks()))
def test_saf_003_a_ur_without_ur_rtde_conforms(check: Check) -> None:
    check()


def test_it_is_commanded_by_the_script() -> None:
    assert ScriptUR("ur5e", "192.0.2.10", ScriptUR.resolve("ur5e", {})).config.control == "script"

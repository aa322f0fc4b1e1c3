"""Test that the conformance suite finds the defects of a driver, and nothing in a correct one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.drivers import get_native_driver_class, list_native_drivers
from strands_actors.kernel.messages import Refused
from strands_actors.testing import Cell, Faults, Outcome, Victims, check_driver, checks
from strands_actors.testing.checks import report
from tests.fake_kinds import KindConfig

from .blinky import Blinky

GOOD = {"joint": 5.0}


class NoFallback(Blinky):
    fallbacks: Mapping[Reason, str] = {reason: "limp" for reason in Reason if reason is not Reason.LINK}


class Hasty(Blinky):
    timing = Timing(control_hz=50.0, keepalive_s=0.1, stream_ttl_s=0.001)


class TakesNan(Blinky):
    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        value = action.get("joint")
        if isinstance(value, float) and math.isnan(value):
            return Candidate((value,), (0,))
        return super().parse(action, state)


class TakesBoth(Blinky):
    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return super().parse({key: value for key, value in action.items() if key != "joint.pos"}, state)


class TakesAnything(Blinky):
    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return Candidate((0.0,), (0,))


class NeverStale(Blinky):
    gates = (lambda candidate, state: None,)


class SaysNothing(Blinky):
    firmware_watchdog = ""


class OneIdTooMany(Blinky):
    ids = (1, 2)


class WrittenForALaterContract(Blinky):
    CONTRACT_VERSION = 2


class NamesNoWire(Blinky):
    WIRE = "tests.fake_kinds:KindStopChannel"
    config = KindConfig("", (), 0.0, 1.0, 1.0)


class GivesAwayItself(Blinky):
    WIRE = "tests.fake_kinds:KindWire"

    @property
    def config(self) -> Any:  # type: ignore[override]
        return self


@pytest.mark.parametrize(
    ("cls", "failing"),
    [
        (NoFallback, {"every reason leads to a safe state", "travels between processes"}),
        (Hasty, {"timing is sane"}),
        (TakesNan, {"refuses what is no finite number"}),
        (TakesBoth, {"refuses one axis under two spellings"}),
        (
            TakesAnything,
            {
                "refuses unknown names",
                "refuses what is no finite number",
                "refuses what is far out of range",
                "refuses one axis under two spellings",
                "refuses an empty action",
            },
        ),
        (NeverStale, {"refuses when nothing was read for long"}),
        (SaysNothing, {"says what its firmware does alone"}),
        (OneIdTooMany, {"declares itself"}),
        (WrittenForALaterContract, {"declares itself"}),
        (NamesNoWire, {"names its wire and stop channel"}),
        (GivesAwayItself, {"names its wire and stop channel"}),
        (Blinky, set()),
    ],
)
def test_saf_014_each_defect_is_found_by_its_name(cls: type[Driver], failing: set[str]) -> None:
    results = check_driver(cls, good=GOOD, twin=False)
    assert {result.name for result in results if not result.passed} == failing
    assert all(result.detail for result in results if not result.passed)
    assert len(list(report(results))) == len(results)


def test_a_class_that_no_other_process_can_import_is_found() -> None:
    class Local(Blinky):
        pass

    failed = [result.name for result in check_driver(Local, good=GOOD, twin=False) if not result.passed]
    assert failed == ["travels between processes"]


@pytest.mark.parametrize("robot", list_native_drivers())
def test_saf_014_our_own_drivers_keep_it(robot: str) -> None:
    cls: Any = get_native_driver_class(robot)
    failed = [result for result in check_driver(cls, robot, twin=False) if not result.passed]
    assert failed == []


def test_a_failure_at_run_time_is_a_result_too() -> None:
    class Broken(Blinky):
        def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
            raise KeyError("joint")

    results = {result.name: result for result in check_driver(Broken, good=GOOD, twin=False)}
    assert results["refuses unknown names"].detail == "KeyError: 'joint'"


def test_one_bench_is_open_at_a_time_and_is_closed_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run of only some of a driver's cells must not leave a moving robot behind during other tests."""
    opened: list[str] = []

    class FakeBench:
        def __init__(self, robot: str, cls: object, far: object) -> None:
            self.robot = robot
            if robot == "broken":
                raise OSError("no twin")

        def __enter__(self) -> FakeBench:
            opened.append(self.robot)
            return self

        def __exit__(self, *_: object) -> None:
            opened.remove(self.robot)

    cell = Cell(Victims.CALLER, Faults.KILL)
    outcome = Outcome("caller", "kill", "hold", 1.0, 50.0, 0, True)
    monkeypatch.setattr(checks, "Bench", FakeBench)
    monkeypatch.setattr(checks, "run_cell", lambda *_: outcome)
    one, other, broken = (
        checks._SharedBench(SimpleNamespace(robot=robot, cls=None), None, users)
        for robot, users in (("one", 2), ("other", 2), ("broken", 1))
    )
    one.check(cell)
    assert opened == ["one"]
    other.check(cell)
    assert opened == ["other"]
    other.check(cell)
    assert opened == [], "the bench closes after its last cell"
    one.check(cell)
    assert opened == []
    with pytest.raises(OSError, match="no twin"):
        broken.check(cell)
    checks._SharedBench(SimpleNamespace(robot="left", cls=None), None, 2).check(cell)
    assert opened == ["left"]
    checks.close_bench()
    assert opened == []

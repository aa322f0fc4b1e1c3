"""SAF-021: every verb that can energise or move a robot is tried against a late stop, on every wire.

A wire has the verbs ``resume`` and ``connect_eagerly``, and each service that powers or moves its robot.
Each verb needs a row on a twin, or a reason why nothing of it can take effect after a stop. Each
wire needs a test in virtual time, or a reason, and a row in the table of ``docs/safety-faults.md``.
"""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import pytest

from strands_actors.contract.driver import Driver, Service
from strands_actors.contract.loading import load
from strands_actors.drivers import WIRES
from strands_actors.testing.bench import driver_of
from tests.drivers.test_late_requests import LATE_VERBS, NOTHING_LATE, OTHER_TESTS
from tests.kill.arming_rows import NO_ROW, ROWS

from .test_imports import ROOT

ALWAYS = ("resume", "connect_eagerly")
PAGE = ROOT / "docs" / "safety-faults.md"
SENTENCE = re.compile(r"[A-Z].{15,}\.")
TITLES = {"can_motors": "CAN motors", "kuka": "KUKA", "rby1": "RB-Y1", "ur": "UR", "unitree_g1": "Unitree"}
"""Name of a wire in the table of the page, where it differs from the wire's name."""


HAND = {"gripper": "any"}
"""An option with which some robots have further services."""


class WireVerbs(NamedTuple):
    """The robots of one wire, and its verbs that can energise or move them."""

    robots: frozenset[str]
    verbs: frozenset[str]
    names: frozenset[str]
    """All verbs, also those that can neither energise nor move a robot."""
    late_s: tuple[float, ...]
    """The times that its robots and services declare for a late request, without zero."""


def can_act(service: Service) -> bool:
    acts = service.powers or service.moves or service.acts or service.ends_motion or service.stops is not None
    return acts or service.late_s > 0


def verbs_of(classes: Iterable[type[Driver]], level: str = "") -> WireVerbs:
    robots, services, late_s = set[str](), dict[str, Service](), set[float]()
    for driver_class in classes:
        services.update(driver_class.SERVICES)
        without, with_hand = driver_class.services({}), driver_class.services(HAND)
        services.update({name: service for name, service in with_hand.items() if name not in without})
        for robot in driver_class.SUPPORTED_ROBOTS:
            robots.add(f"{robot}:{level}" if level else robot)
    for robot in robots:
        late_s.add(driver_of(robot).timing.late_s)
    late_s |= {service.late_s for service in services.values()}
    acting = {name for name, service in services.items() if can_act(service)}
    every = frozenset((*ALWAYS, *services))
    return WireVerbs(frozenset(robots), frozenset((*ALWAYS, *acting)), every, tuple(sorted(late_s - {0.0})))


def wires() -> dict[str, WireVerbs]:
    """Return the verbs of each wire. A level of a wire, such as ``unitree:sport``, counts as a wire."""
    found = dict[str, WireVerbs]()
    for name, location in WIRES.items():
        driver_class: type[Driver] = load(location)
        found[name] = verbs_of([driver_class])
        for level in sorted({level.partition(":")[2] for level in driver_class.LEVELS}):
            classes = [load(each) for key, each in driver_class.LEVELS.items() if key.endswith(f":{level}")]
            found[f"{name}:{level}"] = verbs_of(classes, level)
    return found


FOUND = wires()


def problems(
    verbs: Mapping[str, WireVerbs], tried: Iterable[tuple[str, str]], reasons: Mapping[str, Mapping[str, str]]
) -> list[str]:
    """Return the mistakes in the two tables.

    Args:
        verbs: The wires.
        tried: Robot and verb of each row.
        reasons: Wire to verb to the reason why it has no row.
    """
    wire_of = {robot: wire for wire, each in verbs.items() for robot in each.robots}
    rows = {(wire_of.get(robot, robot), verb) for robot, verb in tried}
    excused = {(wire, verb) for wire, of_wire in reasons.items() for verb in of_wire}
    needed = {(wire, verb) for wire, each in verbs.items() for verb in each.verbs}
    known = {(wire, verb) for wire, each in verbs.items() for verb in each.names}
    return [
        *(f"{wire} {verb}: neither a row nor a reason" for wire, verb in sorted(needed - rows - excused)),
        *(f"{wire} {verb}: a row and a reason" for wire, verb in sorted(rows & excused)),
        *(f"{wire} {verb}: there is no such verb" for wire, verb in sorted((rows | excused) - known)),
    ]


def test_saf_021_every_verb_that_can_energise_or_move_has_a_row_on_a_twin_or_a_reason() -> None:
    assert len([name for name in FOUND if ":" not in name]) == len(WIRES) >= 19
    assert problems(FOUND, ((row.robot, row.verb) for row in ROWS), NO_ROW) == []


def test_saf_021_a_verb_without_a_row_and_a_stale_reason_are_found() -> None:
    duck = WireVerbs(
        frozenset(("duck",)), frozenset(("resume", "enable")), frozenset(("resume", "enable", "mode")), ()
    )
    assert problems({"pond": duck}, [("duck", "resume")], {}) == ["pond enable: neither a row nor a reason"]
    reasons = {"pond": {"enable": "", "resume": "", "mode": "", "swim": ""}}
    assert problems({"pond": duck}, [("duck", "resume")], reasons) == [
        "pond resume: a row and a reason",
        "pond swim: there is no such verb",
    ]


def test_saf_021_a_reason_is_a_sentence() -> None:
    reasons = [*(text for of_wire in NO_ROW.values() for text in of_wire.values()), *NOTHING_LATE.values()]
    assert [text for text in reasons if not SENTENCE.fullmatch(text)] == []


def test_saf_021_every_wire_has_a_test_in_virtual_time_or_a_reason() -> None:
    robots = {row.robot for row in LATE_VERBS}
    tested = {*OTHER_TESTS, *(wire for wire, each in FOUND.items() if each.robots & robots)}
    assert FOUND.keys() - tested - NOTHING_LATE.keys() == set()
    assert (tested | NOTHING_LATE.keys()) - FOUND.keys() == set()
    assert tested & NOTHING_LATE.keys() == set()
    assert [wire for wire in NOTHING_LATE if FOUND[wire].late_s] == [], "a request can be late, so it needs a test"


@pytest.mark.parametrize("wire", OTHER_TESTS)
def test_saf_021_the_named_tests_exist(wire: str) -> None:
    path, _, name = OTHER_TESTS[wire].partition("::")
    tree = ast.parse((ROOT / path).read_text())
    assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    module = importlib.import_module(path.removesuffix(".py").replace("/", "."))
    assert callable(getattr(module, name))


def table() -> list[list[str]]:
    """Return the cells of the page's table of late requests."""
    section = PAGE.read_text().partition("\n## What a stop can overtake\n")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")][2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


@pytest.mark.parametrize("wire", FOUND)
def test_saf_021_the_page_has_each_wire_with_its_time_and_the_source(wire: str) -> None:
    folder, _, level = wire.partition(":")
    title = TITLES.get(folder, folder)
    rows = [cells for cells in table() if re.search(rf"\b{title}\b", cells[0], re.IGNORECASE)]
    rows = [cells for cells in rows if ("walking" in cells[0]) is bool(level)]
    assert rows, f"{PAGE.name} has no row for {wire}"
    assert all(len(cells) == 4 and all(cells) for cells in rows)
    for late_s in FOUND[wire].late_s:
        assert any(re.search(rf"(?<![\d.]){late_s:g} s\b", cells[2]) for cells in rows), f"{wire}: {late_s:g} s"

"""Each kind of mutation makes its mistake, and the lists of places and tests are valid."""

from __future__ import annotations

import ast

import pytest

from .mutations import mutations
from .places import PLACES, ROOT, Place, source_of

CODE = '''
TABLE = {"a": 1, "b": 2}


async def make_safe(self, axes):
    """Docs."""
    self.write(axes)
    for axis in axes:
        if axis.late and axis.old:
            return False
    self.epoch = self.epoch + 1


def may(self) -> Refused | None:
    if self.now >= self.until:
        return Refused("expired", "late")
    return None
'''


def found(kind: str) -> list[tuple[str, str]]:
    return [(each.before, each.after) for each in mutations(CODE) if each.kind == kind]


def test_each_kind_makes_its_mistake() -> None:
    assert found("drop") == [('{"a": 1, "b": 2}', "{'b': 2}"), ('{"a": 1, "b": 2}', "{'a': 1}")]
    assert found("delay") == [
        ("self.write(axes)", "import trio as _late; await _late.sleep(0.3) self.write(axes)"),
    ]
    assert ("self.write(axes)", "pass") in found("skip")
    assert found("turn") == [
        ("axis.late and axis.old", "not (axis.late and axis.old)"),
        ("self.now >= self.until", "not (self.now >= self.until)"),
    ]
    assert found("edge") == [("self.now >= self.until", "self.now > self.until")]
    assert found("swap") == [("axis.late and axis.old", "((axis.late) or (axis.old))")]
    assert found("flip") == [("return False", "return True")]
    assert found("let through") == [('return Refused("expired", "late")', "return None")]
    assert found("off by one") == [("self.epoch + 1", "self.epoch")]
    assert found("forget one") == [("axes", "list(axes)[1:]")]


def test_only_the_named_functions_are_mutated() -> None:
    assert {each.function for each in mutations(CODE, ("may",))} == {"may"}


@pytest.mark.parametrize("place", PLACES, ids=lambda place: place.path)
def test_its_mutations_are_python_and_its_tests_exist(place: Place) -> None:
    made = list(mutations(source_of(place), place.functions))
    assert made, "no mutation exists for this place"
    for each in made[::9]:
        ast.parse(each.source)
        assert each.source != source_of(place)
    for test in place.tests:
        assert (ROOT / test.partition("::")[0]).exists(), test


def test_there_are_enough() -> None:
    total = sum(len(list(mutations(source_of(place), place.functions))) for place in PLACES)
    assert total >= 600

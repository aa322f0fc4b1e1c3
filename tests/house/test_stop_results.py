"""SAF-023 by type: each function that ends motion returns a result, never None."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import get_args

import pytest

from strands_actors.supervisors.stop_result import Confirmed, StopResult, Unconfirmed, Unreachable
from strands_actors.surfaces.mesh.outcome import Outcome, Verdict

from .test_imports import MODULES, PACKAGE

ENDS_MOTION = re.compile(r"_?(stop|estop|release|cleanup|make_safe|stop_task|hold|end)(_here|_root|_from_child)?")
WHERE = (
    f"{PACKAGE}.caller.",
    f"{PACKAGE}.surfaces.cli.",
    f"{PACKAGE}.surfaces.mesh.",
    f"{PACKAGE}.surfaces.drill.",
    f"{PACKAGE}.supervisors.root.stopping",
)
RESULTS = {
    "StopResult",
    "StopResult | Refused",  # refused: no motion was ended, and no robot was reported as stopped
    "StopReport | Refused",
    "TaskEnd",
    "Answer",
    "Answer | PendingAnswer",
    "Outcome",
    "list[Outcome]",
    "tuple[bool, str]",  # whether it is confirmed, and a line for people
    "list[RobotResult]",
    "int",  # an exit code
    "StepResult",
}
"""Types that such a function may return."""
NO_ROBOT = {
    "caller.session.rollouts:Rollouts.end",  # removes an entry after the robot was stopped
    "caller.processes.run_directory:Name.release",  # a lock on a file
    "caller.processes.strays:end",  # ends a process; its caller never counts that as a safe robot
    "surfaces.cli.__init__:stop",  # these end by typer.Exit
    "surfaces.cli.__init__:estop",
    "surfaces.cli.demo.watch:Watch.stop",
    "surfaces.cli.top.rows:_stop",  # shows a report
}


def functions(name: str, source: str) -> Iterator[tuple[str, str]]:
    """Yield each function with a name that promises an end of motion, and its annotated return type."""

    def walk(body: list[ast.stmt], inside: str) -> Iterator[tuple[str, str]]:
        for node in body:
            if isinstance(node, ast.ClassDef):
                yield from walk(node.body, f"{node.name}.")
            elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and ENDS_MOTION.fullmatch(node.name):
                returns = "nothing is said" if node.returns is None else ast.unparse(node.returns)
                yield f"{name}:{inside}{node.name}", returns

    return walk(ast.parse(source).body, "")


def wrong(found: Iterator[tuple[str, str]]) -> list[str]:
    return [f"{where} -> {returns}" for where, returns in found if where not in NO_ROBOT and returns not in RESULTS]


def all_functions() -> Iterator[tuple[str, str]]:
    for name, path in MODULES.items():
        if f"{name}.".startswith(WHERE):
            short = name.removeprefix(f"{PACKAGE}.")
            yield from functions(f"{short}.__init__" if path.name == "__init__.py" else short, path.read_text())


def test_saf_023_nothing_that_ends_motion_can_return_none() -> None:
    found = list(all_functions())
    assert {where for where, _ in found} >= NO_ROBOT, "an exception in the list no longer exists"
    assert len(found) > 30
    assert wrong(iter(found)) == []


@pytest.mark.parametrize(
    "returns", ["StopReport | None", "StopResult | None", "Optional[StopResult]", "None", "bool"]
)
def test_saf_023_a_result_that_can_be_absent_is_found(returns: str) -> None:
    source = f"class Tree:\n    async def cleanup(self) -> {returns}: ...\n"
    assert wrong(functions("caller.session.tree", source)) == [f"caller.session.tree:Tree.cleanup -> {returns}"]


def test_saf_023_a_stop_has_three_results_and_no_fourth() -> None:
    assert get_args(StopResult) == (Confirmed, Unconfirmed, Unreachable)
    assert get_args(Verdict) == ("safe", "unconfirmed", "unreachable")
    assert Outcome.__annotations__["outcome"] == "Verdict"

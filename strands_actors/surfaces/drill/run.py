"""Run a whole drill: connect, check that the robot is at rest, carry out the steps, write a certificate."""

from __future__ import annotations

import contextlib
import platform
import tempfile
from collections.abc import Awaitable, Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import trio

from strands_actors.caller.handle.async_robot import open_tree
from strands_actors.caller.processes.plan import Plan
from strands_actors.caller.processes.robot_processes import NotConnected
from strands_actors.caller.resolve.planning import completed, plan
from strands_actors.caller.session.tree import RobotTree
from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import WireDown
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.testing.twin import Twin
from strands_actors.version import __version__

from .certificate import TWIN, Certificate, StepResult, config_of, keep, revoke
from .connection import Connection, connection_of
from .lowering import LoweringDrill
from .report import Report, is_reportable, report_of
from .steps import Drill, Failed

REST_S = 0.5
REST_WITHIN_S = 15.0
"""How long to wait for rest. A robot that has just lost torque sinks before it lies still."""
REST = {"degrees": 1.0}
"""Largest motion of an axis at rest within ``REST_S``, by the beginning of the unit's name. For other units
it is ``REST_ELSE``."""
REST_ELSE = 0.02


class Outcome(NamedTuple):
    """The result of a drill.

    Attributes:
        results: The results of the steps.
        certificate: The certificate; None if the drill was not passed.
        path: The file of the certificate; None if the drill was not passed.
        report: The report that the user may send to the project; None if the driver is not of this package.
    """

    results: list[StepResult]
    certificate: Certificate | None
    path: Path | None
    report: Report | None = None

    @property
    def passed(self) -> bool:
        return self.certificate is not None


async def run_drill(
    robot: str,
    port: str | None,
    options: dict[str, Any],
    tell: Callable[[str], Awaitable[None]],
    done: Callable[[StepResult], None] = lambda _: None,
) -> Outcome:
    """Run a drill. A drill that fails removes the certificate of this configuration.

    Args:
        robot: The kind of the robot.
        port: The robot's port. None drills a simulated robot.
        options: The options of the robot.
        tell: Called with each instruction for the operator.
        done: Called with the result of each step.

    Raises:
        ValueError: The robot or an option is wrong.
        ConnectionError: The robot cannot be reached.
        Failed: The robot is not at rest, or cannot be read.
    """
    # Raise ValueError for a wrong argument before anything is started.
    plan(robot, "real", port=port, transport="twin" if port is None else None, **options)
    with _behind(robot, port) as (twin, address):
        try:
            drilled = await completed(plan(robot, "real", port=address, **options))
        except WireDown as down:
            raise ConnectionError(str(down)) from None
        config = config_of(drilled.driver_class, drilled.robot, TWIN if twin else address, drilled.options)
        results: list[StepResult] = []
        async with open_tree(drilled) as tree:
            await _must_rest(tree, tell)
            await tree.status()
            facts = tree.facts
            for step in Drill(tree, twin, tell).steps.values():
                results.append(await _try(step, tree.driver))
                done(results[-1])
            driver = tree.driver
        if driver.fallbacks[Reason.CALLER] is SafeState.LOWERED:
            results.append(await _try(LoweringDrill(drilled, options, twin, tell).script_kill, driver))
            done(results[-1])
    report = None
    if is_reportable(drilled.robot, drilled.driver_class):
        connection = Connection.TWIN if twin else connection_of(address)
        report = report_of(drilled.robot, drilled.driver_class, connection, facts, results)
    if not all(result.passed for result in results):
        revoke(drilled.robot, config)
        return Outcome(results, None, None, report)
    certificate = _certificate(drilled, TWIN if twin else address, config, results)
    return Outcome(results, certificate, keep(certificate), report)


@contextlib.contextmanager
def _behind(robot: str, port: str | None) -> Iterator[tuple[Twin | None, str]]:
    if port is not None:
        yield None, port
        return
    with tempfile.TemporaryDirectory(prefix="sa-") as directory, Twin(robot, Path(directory)) as twin:
        yield twin, twin.port


async def _try(step: Callable[[], Awaitable[StepResult]], driver: Driver) -> StepResult:
    """Carry out a step. A step that cannot be carried out counts as failed."""
    name = step.__name__.replace("_", " ")
    try:
        return await step()
    except* (Failed, NotConnected, AskTimeout, Unreachable) as failures:
        reason = "; ".join(str(failure) for failure in failures.exceptions)
    return StepResult(name, False, driver.fallbacks[Reason.STOP], None, None, driver.bound_s * 1e3, None, reason)


async def _must_rest(tree: RobotTree, tell: Callable[[str], Awaitable[None]]) -> None:
    motion = await _moving_parts(tree)
    if motion:
        await tell(f"{motion}. Waiting until it rests.")
    with trio.move_on_after(REST_WITHIN_S):
        while motion:
            motion = await _moving_parts(tree)
    if motion:
        raise Failed(f"{motion}. Bring the robot to rest first")


async def _moving_parts(tree: RobotTree) -> str:
    before = await tree.observe()
    await trio.sleep(REST_S)
    after = await tree.observe()
    for observation in (before, after):
        if isinstance(observation, Refused):
            raise Failed(observation.text)
    assert not isinstance(before, Refused) and not isinstance(after, Refused)
    unit = tree.driver.unit
    limit = next((far for name, far in REST.items() if unit.startswith(name)), REST_ELSE)
    for axis, was, now in zip(tree.driver.axes, before.position, after.position, strict=True):
        if abs(now - was) > limit:
            return f"{axis} moves: from {was:.2f} to {now:.2f} ({unit})"
    return ""


def _certificate(drilled: Plan, port: str, config: str, results: list[StepResult]) -> Certificate:
    versions = {
        "strands-actors": __version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
    }
    date = datetime.now(UTC).isoformat(timespec="seconds")
    driver = f"{drilled.driver_class.__module__}:{drilled.driver_class.__qualname__}"
    return Certificate(drilled.robot, driver, port, config, date, versions, results)

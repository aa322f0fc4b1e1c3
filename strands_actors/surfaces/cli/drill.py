"""``drill``: test on your robot that each kind of fault stops it."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import trio

from strands_actors.caller.processes.plan import Plan
from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.surfaces.drill.run import Outcome, run_drill
from strands_actors.surfaces.drill.steps import Failed, runs_policies

from . import drill_report
from .calibrate import person_of
from .errors import Problem

CONSENT = """\
The drill of {robot} at {port}.

It energises the robot where it is, moves nothing, and makes it safe {count} times: by a stop, by killing its policy
and its wire process, by freezing its root process, and with its cable out (you will be asked to pull it).
Each time an arm may sink or fall: {safe_states}.
Have it at rest on its support, hands off, your hand near its power switch.
"""
LOWERING = """\
In the end you will be asked to raise the arm. It is laid down when the script that holds it is killed.
"""


def run(
    robot: str,
    port: str | None,
    twin: bool,
    yes: bool,
    options: list[str],
    as_json: bool,
    report: Path | None = None,
    dialogue: bool = False,
) -> int:
    """Run the drill after the user's consent.

    Args:
        robot: The type of the robot.
        port: The port or address of a real robot. None for a simulated robot.
        twin: Drill a simulated robot.
        yes: Do not ask for consent, because the user has consented in another way.
        options: ``KEY=VALUE`` keywords of ``Robot``.
        as_json: Print JSON.
        report: Write a report of the drill to this new file. None writes no report.
        dialogue: Ask by lines of JSON.

    Returns:
        The exit code: 0 if the drill was passed, else 1.
    """
    if (port is None) != twin:
        raise Problem("drill: no robot is chosen. Give --port PORT for a real robot, or --twin for a simulated one")
    keywords = _keywords(options)
    if report is not None:
        drill_report.check(report, _planned(robot, port, keywords))
    person = person_of(as_json, dialogue)
    if not twin and not yes and not person.consents(_consent_text(robot, str(port), keywords), robot):
        raise Problem("drill: you did not consent, so nothing was done")

    async def tell(text: str) -> None:
        person.instruct(text)

    try:
        outcome = trio.run(run_drill, robot, port, keywords, tell, person.step)
    except (ValueError, TypeError, ConnectionError, Failed) as refusal:
        raise Problem(f"drill: {refusal}") from refusal
    problem = drill_report.write(outcome, report)
    _print(robot, outcome, as_json)
    if problem:
        raise Problem(problem)
    if report is not None and not as_json:
        drill_report.show(outcome, report)
    return 0 if outcome.passed else 1


def _keywords(options: list[str]) -> dict[str, str]:
    """Return the options ``KEY=VALUE`` as keywords of ``Robot``. A value that is not valid JSON is used as
    text."""
    keywords = {}
    for option in options:
        key, equals, text = option.partition("=")
        if not equals:
            raise Problem(f"drill: --option {option!r} is not KEY=VALUE")
        try:
            keywords[key] = json.loads(text)
        except ValueError:
            keywords[key] = text
    return keywords


def _planned(robot: str, port: str | None, keywords: dict[str, str]) -> Plan:
    from strands_actors.caller.resolve.planning import plan

    try:
        return plan(robot, "real", port=port, transport="twin" if port is None else None, **keywords)
    except (ValueError, TypeError) as refusal:
        raise Problem(f"drill: {refusal}") from refusal


def _consent_text(robot: str, port: str, keywords: dict[str, str]) -> str:
    planned = _planned(robot, port, keywords)
    try:
        driver = planned.driver_class(planned.robot, port, planned.options)
    except (ValueError, TypeError) as refusal:
        raise Problem(f"drill: {refusal}") from refusal
    safe_states = ", ".join(
        f"{safe_state} after {reason}"
        for reason, safe_state in driver.fallbacks.items()
        if reason in ("stop", "policy")
    )
    count = 5 if runs_policies(driver) else 4
    texts = [CONSENT.format(robot=robot, port=port, count=count, safe_states=safe_states)]
    if driver.fallbacks[Reason.CALLER] is SafeState.LOWERED:
        texts.append(LOWERING)
    if driver.BEFORE_MOTION:
        texts.append(f"Before each of them it does {driver.BEFORE_MOTION}(). Keep clear of it.")
    return "\n".join(texts)


def _print(robot: str, outcome: Outcome, as_json: bool) -> None:
    if as_json:
        certificate = None if outcome.path is None else str(outcome.path)
        answer = {
            "robot": robot,
            "passed": outcome.passed,
            "figures": [msgspec.to_builtins(result) for result in outcome.results],
            "certificate": certificate,
            "report": msgspec.to_builtins(outcome.report),
        }
        print(json.dumps(answer))
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 0))  # Without padding, the longest entries fit into 80 columns.
    for title in ("step", "state", "safe", "bound", "confirmed", "after", "verdict"):
        is_text = title in ("step", "state", "verdict")
        table.add_column(title, justify="left" if is_text else "right", no_wrap=True)
    for result in outcome.results:
        table.add_row(
            result.step,
            result.safe_state,
            _ms(result.safe_ms),
            _ms(result.bound_ms),
            _ms(result.confirmed_ms),
            "–" if result.setpoints_after is None else str(result.setpoints_after),
            "ok" if result.passed else "[bold red]FAILED[/]",
        )
    console.print(table)
    for result in outcome.results:  # Details are too long for a column, so print them below the table.
        if result.detail:
            text = f"{result.step}: {result.detail}" if result.passed else f"{result.step} FAILED: {result.detail}"
            console.print(Text(text, "" if result.passed else "bold red"))
    if outcome.certificate is not None:
        print(f"passed. Certificate: {outcome.path}")
    else:
        print("not passed: no certificate, an earlier one was taken back")


def _ms(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f} ms"

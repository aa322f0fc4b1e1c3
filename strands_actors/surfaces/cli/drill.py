"""``drill``: prove on the robot in front of you that it can be stopped."""

from __future__ import annotations

import json
import sys

import msgspec
import trio

from strands_actors.surfaces.drill.certificate import Figure
from strands_actors.surfaces.drill.run import Outcome, run_drill
from strands_actors.surfaces.drill.steps import Failed, runs_policies

from .errors import Problem

CONSENT = """\
The drill of {robot} at {port}.

It energises the robot where it is, moves nothing, and makes it safe {count} times: by a stop, by killing its policy
and its wire process, by freezing its root process, and with its cable out (you will be asked to pull it).
Each time an arm may sink or fall: {safe_states}.
Have it at rest on its support, hands off, your hand near its power switch.
"""


def run(robot: str, port: str | None, twin: bool, yes: bool, options: list[str], as_json: bool) -> int:
    """Run the drill after the user's consent.

    Args:
        robot: The type of the robot.
        port: The port or address of a real robot; None for the twin.
        twin: Drill the twin.
        yes: The user has consented elsewhere.
        options: ``KEY=VALUE`` keywords of ``Robot``.
        as_json: Print JSON.

    Returns:
        The exit code: 0 if the drill was passed, else 1.
    """
    if (port is None) != twin:
        raise Problem("drill: say which robot: --port PORT for a real one, --twin for its twin")
    keywords = _keywords(options)
    if not twin and not yes:
        _consent(robot, str(port), keywords)

    async def tell(text: str) -> None:
        print(f"  >> {text}", file=sys.stderr, flush=True)

    def show(figure: Figure) -> None:
        if not as_json:
            mark = "ok" if figure.passed else "FAILED"
            print(f"  {figure.step:<12} {mark}", file=sys.stderr, flush=True)

    try:
        outcome = trio.run(run_drill, robot, port, keywords, tell, show)
    except (ValueError, TypeError, ConnectionError, Failed) as refusal:
        raise Problem(f"drill: {refusal}") from refusal
    _print(robot, outcome, as_json)
    return 0 if outcome.passed else 1


def _keywords(options: list[str]) -> dict[str, str]:
    """Return the options ``KEY=VALUE`` as keywords of ``Robot``. A value that is no valid JSON is text."""
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


def _consent(robot: str, port: str, keywords: dict[str, str]) -> None:
    from strands_actors.caller.resolve.planning import plan

    try:
        planned = plan(robot, "real", port=port, **keywords)
        driver = planned.driver_class(planned.robot, port, planned.options)
    except (ValueError, TypeError) as refusal:
        raise Problem(f"drill: {refusal}") from refusal
    safe_states = ", ".join(
        f"{safe_state} after {reason}"
        for reason, safe_state in driver.fallbacks.items()
        if reason in ("stop", "policy")
    )
    count = 5 if runs_policies(driver) else 4
    print(CONSENT.format(robot=robot, port=port, count=count, safe_states=safe_states), file=sys.stderr)
    if driver.BEFORE_MOTION:
        print(f"Before each of them it does {driver.BEFORE_MOTION}(). Keep clear of it.", file=sys.stderr)
    if not sys.stdin.isatty():
        raise Problem("drill: nobody is there to consent. pass --yes when that was done elsewhere")
    print(f"Type {robot} to go on: ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip() != robot:
        raise Problem("drill: not consented, nothing was done")


def _print(robot: str, outcome: Outcome, as_json: bool) -> None:
    if as_json:
        figures = [msgspec.to_builtins(figure) for figure in outcome.figures]
        report = {"robot": robot, "passed": outcome.passed, "figures": figures}
        print(json.dumps(report | {"certificate": None if outcome.path is None else str(outcome.path)}))
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 0))  # fits into 80 columns with the longest entries
    for title in ("step", "state", "safe", "bound", "confirmed", "after", "verdict"):
        left = title in ("step", "state", "verdict")
        table.add_column(title, justify="left" if left else "right", no_wrap=True)
    for figure in outcome.figures:
        table.add_row(
            figure.step,
            figure.safe_state,
            _ms(figure.safe_ms),
            _ms(figure.bound_ms),
            _ms(figure.confirmed_ms),
            "–" if figure.setpoints_after is None else str(figure.setpoints_after),
            "ok" if figure.passed else "[bold red]FAILED[/]",
        )
    console.print(table)
    for figure in outcome.figures:  # below the table, since a column would cut them off
        if figure.detail:
            text = f"{figure.step}: {figure.detail}" if figure.passed else f"{figure.step} FAILED: {figure.detail}"
            console.print(Text(text, "" if figure.passed else "bold red"))
    if outcome.certificate is not None:
        print(f"passed. certificate: {outcome.path}")
    else:
        print("not passed: no certificate, an earlier one was taken back")


def _ms(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f} ms"

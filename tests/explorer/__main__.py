"""``python -m tests.explorer``: search for a seed that breaks a promise, or replay one."""

from __future__ import annotations

import gc
import os
import sys
import time
from datetime import timedelta
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from .plan import Plan, plan_of
from .robots import ROBOTS
from .search import Result, run_here, run_seeds
from .shrink import shrink
from .table import history_table, plan_table

console = Console()


def main(
    seeds: Annotated[int, typer.Option(help="How many seeds to run.")] = 1000,
    first: Annotated[int, typer.Option(help="The first of them.")] = 0,
    seed: Annotated[int | None, typer.Option(help="Replay this one, step by step.")] = None,
    robot: Annotated[str, typer.Option(help=f"One of {', '.join(ROBOTS)}.")] = "so101",
    jobs: Annotated[int, typer.Option(help="Processes at a time.")] = os.cpu_count() or 1,
    whole: Annotated[bool, typer.Option(help="Replay the plan as drawn, and every message.")] = False,
    keep_going: Annotated[bool, typer.Option(help="Do not end at the first failure.")] = False,
) -> None:
    """Run a simulated tree of ROBOT under drawn faults and orders; every promise is checked at
    every frame."""
    if robot not in ROBOTS:
        raise typer.BadParameter(f"{robot} is not modelled. Use one of {', '.join(ROBOTS)}", param_hint="--robot")
    gc.disable()
    if seed is not None:
        code = replay(plan_of(seed, robot), whole)
    else:
        code = search(range(first, first + seeds), robot, jobs, keep_going)
    sys.stdout.flush()
    os._exit(code)  # Do not clean up the remains of killed processes: see ``search``.


def search(seeds: range, robot: str, jobs: int, keep_going: bool) -> int:
    """Return the exit code: 1 if a promise was broken."""
    failed: list[Result] = []
    began_s = time.monotonic()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[progress]}"),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(robot, total=len(seeds), progress="")
        for done, result in enumerate(run_seeds(seeds, robot, jobs), 1):
            told = progress_text(done, len(seeds), time.monotonic() - began_s)
            progress.update(task, completed=done, progress=told)
            if result.violations:
                failed.append(result)
                progress.console.print(f"seed {result.plan.seed}: {result.violations[0].invariant}", style="red")
                if not keep_going:
                    break
    if not failed:
        console.print(f"{robot}: {len(seeds)} seeds from {seeds.start}, no promise broken")
        return 0
    replay(failed[0].plan, False)
    console.print(f"again, step by step: --robot {robot} --seed {failed[0].plan.seed}")
    return 1


def progress_text(done: int, of: int, passed_s: float) -> str:
    """Return the progress. The rate is the average since the beginning, because results come by the dozen
    and a shorter average would jump."""
    left = timedelta(seconds=round((of - done) * passed_s / done))
    return f"{done / passed_s:.1f} seeds/s, {left} left"


def replay(plan: Plan, whole: bool) -> int:
    run = run_here(plan)
    if run.violations and not whole:
        plan = shrink(plan, run.violations[0].invariant)
        run = run_here(plan)
    shorter = "" if whole else ", as short as it fails" if run.violations else ""
    console.print(plan_table(plan, f"seed {plan.seed} of {plan.robot}{shorter}"))
    console.print(history_table(run.world.rows, run.violations, whole))
    for violation in run.violations:
        console.print(f"{violation.invariant}: {violation.detail}", style="bold red")
    console.print(f"history {run.digest()}")
    return 1 if run.violations else 0


if __name__ == "__main__":
    typer.run(main)

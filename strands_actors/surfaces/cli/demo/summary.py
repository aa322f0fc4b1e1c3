"""Print the results of the demo: a table for people, or a JSON object for programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from .scenario import CONTROL_HZ, Outcome, Pace


def as_plain(
    outcomes: list[Outcome], pace: Pace | None, took_s: float, picture: Path | None, problem: str, ok: bool
) -> dict[str, Any]:
    return {
        "ok": ok,
        "problem": problem or None,
        "robot": "so101",
        "took_s": round(took_s, 2),
        "pace": None if pace is None else _rounded(pace),
        "faults": [
            {
                "fault": outcome.signal,
                "victim": outcome.victim,
                "pid": outcome.pid,
                "safe_state": outcome.safe_state,
                "safe_after_ms": None if outcome.safe_after_ms is None else round(outcome.safe_after_ms, 2),
                "bound_ms": outcome.bound_ms,
                "setpoints_after": outcome.setpoints_after,
                "watched_s": round(outcome.watched_s, 2),
                "restarted": outcome.restarted,
                "rearmed": outcome.rearmed,
                "safe": outcome.safe,
                "detail": outcome.detail or None,
            }
            for outcome in outcomes
        ],
        "picture": None if picture is None else str(picture),
    }


def _rounded(pace: Pace) -> dict[str, float]:
    return {"asked_hz": CONTROL_HZ} | {
        name: round(value, 2) for name, value in msgspec.structs.asdict(pace).items()
    }


def show(console: Console, outcomes: list[Outcome], pace: Pace | None) -> None:
    if pace is not None:
        console.print(
            f"\nundisturbed: policy at {pace.policy_hz:.1f} Hz of {CONTROL_HZ:g}, "
            f"{pace.setpoints_per_s:.0f} setpoints/s on the wire\n"
            f"between setpoints: median {pace.gap_ms_median:.1f} ms, 99 % below {pace.gap_ms_p99:.1f} ms, "
            f"longest {pace.gap_ms_max:.1f} ms"
        )
    if not outcomes:
        return
    table = Table(
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
        title="\nfrom the fault to the safe frame, by the wire's own log",
    )
    for title in ("fault", "safe\nstate"):
        table.add_column(title)
    for title in ("after", "bound", "setpoints\nafter"):
        table.add_column(title, justify="right")
    for title in ("re-\nstarted", "re-\narmed", "verdict"):
        table.add_column(title)
    for outcome in outcomes:
        after_ms = outcome.safe_after_ms
        table.add_row(
            f"{outcome.signal} {outcome.victim}",
            outcome.safe_state,
            "never" if after_ms is None else f"{after_ms:.1f} ms",
            f"{outcome.bound_ms:.0f} ms",
            str(outcome.setpoints_after),
            "yes" if outcome.restarted else "NO",
            "yes" if outcome.rearmed else "NO",
            Text("safe", "bold green") if outcome.safe else Text("NOT SAFE", "bold red"),
        )
    console.print(table)
    for outcome in outcomes:
        if outcome.detail:
            console.print(f"{outcome.victim}: {outcome.detail}", style="bold red")

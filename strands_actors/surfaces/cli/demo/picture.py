"""Draw ``demo.png``: the position and the setpoint of each joint over time, and the faults."""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from strands_actors.kernel.clock import NS

from .scenario import Outcome
from .watch import Sample, Watch

GAP_S = 0.25
"""If readings are further apart than this, in seconds, the line has a gap, because the position is unknown."""

COLORS = ("#1f6fb4", "#2a9d5c", "#b8621b", "#7b52ab", "#c03a4b", "#4d6a7a")
SETPOINT = "#222222"
DASHES = (0, (4, 2))
FAULT = "#c1121f"
SAFE = "#f4b942"


def draw(path: Path, watch: Watch, outcomes: list[Outcome], began_ns: int) -> None:
    figure = Figure(figsize=(12, 9), dpi=110)
    FigureCanvasAgg(figure)
    figure.suptitle(
        "SO-101: joints, setpoints, and what was done to its processes"
        if outcomes
        else "SO-101: joints and setpoints",
        fontsize=14,
        fontweight="bold",
        x=0.06,
        ha="left",
        y=0.985,
    )
    text = "Whichever process is lost, the arm is made safe, and only resume() lets it move again."
    gaps = " Where a line is missing, no process was left to read the arm."
    figure.text(0.06, 0.945, text + gaps if outcomes else "", fontsize=10, color="#555555")
    plots = figure.subplots(len(watch.axes), 1, sharex=True, squeeze=False)[:, 0]
    figure.subplots_adjust(left=0.085, right=0.985, top=0.87 if outcomes else 0.93, bottom=0.105, hspace=0.16)
    for index, (plot, axis) in enumerate(zip(plots, watch.axes, strict=True)):
        color = COLORS[index % len(COLORS)]
        plot.plot(*_curve(watch.positions, index, began_ns), color=color, linewidth=1.8, zorder=3)
        plot.plot(
            *_curve(watch.targets, index, began_ns), color=SETPOINT, linewidth=1.0, linestyle=DASHES, zorder=4
        )
        unit = "% open" if "gripper" in axis else "degrees"
        plot.set_ylabel(f"{axis}\n{unit}", fontsize=8)
        plot.tick_params(labelsize=8)
        plot.grid(True, color="#e6e6e6", linewidth=0.7)
        plot.margins(x=0.01, y=0.12)
        for side in ("top", "right"):
            plot.spines[side].set_visible(False)
        for outcome in outcomes:
            struck = (outcome.struck_ns - began_ns) / NS
            if outcome.safe_ns is not None and outcome.resumed_ns is not None:
                plot.axvspan(
                    (outcome.safe_ns - began_ns) / NS,
                    (outcome.resumed_ns - began_ns) / NS,
                    color=SAFE,
                    alpha=0.28,
                    linewidth=0,
                    zorder=1,
                )
            plot.axvline(struck, color=FAULT, linewidth=1.3, zorder=5)
    for outcome in outcomes:
        after_ms = outcome.safe_after_ms
        after = "never safe" if after_ms is None else f"{outcome.safe_state} after {after_ms:.1f} ms"
        plots[0].annotate(
            f"{outcome.signal} {outcome.victim}\n{after}",
            ((outcome.struck_ns - began_ns) / NS, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 4),
            textcoords="offset points",
            fontsize=8.5,
            color=FAULT,
            va="bottom",
        )
    plots[-1].set_xlabel("time since the demo began, s")
    handles = [
        Line2D([], [], color=COLORS[0], linewidth=1.8, label="measured position"),
        Line2D([], [], color=SETPOINT, linewidth=1.0, linestyle=DASHES, label="setpoint"),
    ]
    if outcomes:
        handles += [
            Line2D([], [], color=FAULT, linewidth=1.3, label="a process is killed or frozen"),
            Patch(color=SAFE, alpha=0.28, label="safe, until resume()"),  # type: ignore[list-item]
        ]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, fontsize=9)
    figure.savefig(path, format="png")


def _curve(samples: list[Sample], index: int, began_ns: int) -> tuple[list[float], list[float]]:
    """Return the curve of one axis as times and positions. Where readings are missing, a NaN makes a gap in the
    line."""
    xs: list[float] = []
    ys: list[float] = []
    for sample in samples:
        t = (sample.t_ns - began_ns) / NS
        if xs and t - xs[-1] > GAP_S:
            xs.append(t)
            ys.append(float("nan"))
        xs.append(t)
        ys.append(sample.values[index])
    return xs, ys

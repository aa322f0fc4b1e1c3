"""Make ``docs/fleet.md`` and its picture from the results of ``benchmarks.sides.scale``.

``python -m benchmarks.sides.scale --write`` calls this. The results are kept one file for each number of robots.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from strands_actors.testing.markdown import paragraph

from .house import HOUSE, RESULTS, Machine
from .page import number, row

KEPT = RESULTS / "scale"
PAGE = HOUSE.parent / "docs" / "fleet.md"
PICTURE = HOUSE.parent / "docs" / "pictures" / "fleet.svg"
MODELLED = (1000, 10_000)
"""Numbers of robots for which the page has figures of the model, if they were not measured."""

MEDIAN, WORST = "outcomes_p50_ms", "outcomes_worst_ms"
PARTS = {
    "central_router_pct": "central router",
    "routers_pct": "all other routers",
    "metrics_pct": "metrics of a host",
    "console_pct": "console with one page",
}


@dataclass(frozen=True)
class Curve:
    """A power law, ``factor * robots ** power``, through measured figures.

    Processes that share two cores wait the longer for each other, the more there are, so times and costs grow
    faster than the number of robots.
    """

    factor: float
    power: float

    @classmethod
    def through(cls, points: Sequence[tuple[float, float]]) -> Curve:
        """Fit a power law by least squares of the logarithms.

        Args:
            points: Numbers of robots with their figures, at least two of them.
        """
        logs = [(math.log(x), math.log(max(y, 0.1))) for x, y in points]
        mean_x, mean_y = (sum(values) / len(logs) for values in zip(*logs, strict=True))
        spread = sum((x - mean_x) ** 2 for x, _ in logs)
        power = sum((x - mean_x) * (y - mean_y) for x, y in logs) / spread
        return cls(math.exp(mean_y - power * mean_x), power)

    def at(self, robots: float) -> float:
        return float(self.factor * robots**self.power)

    def reaches(self, value: float) -> float:
        """Return the number of robots at which the curve has this value."""
        return float((value / self.factor) ** (1.0 / self.power))


@dataclass(frozen=True)
class Kept:
    """The figures of one number of robots, and where they were measured."""

    figures: Mapping[str, float]
    machine: Machine
    in_namespaces: bool


def keep(figures: Mapping[str, float], machine: Machine, in_namespaces: bool) -> None:
    """Store the figures of one number of robots."""
    KEPT.mkdir(parents=True, exist_ok=True)
    stored = {"figures": dict(figures), "machine": asdict(machine), "in_namespaces": in_namespaces}
    (KEPT / f"{figures['robots']:05.0f}.json").write_text(json.dumps(stored, indent=1) + "\n")


def kept() -> list[Kept]:
    """Return all stored figures, by the number of robots."""
    rows: list[dict[str, Any]] = [json.loads(path.read_text()) for path in sorted(KEPT.glob("*.json"))]
    return [Kept(row["figures"], Machine(**row["machine"]), row["in_namespaces"]) for row in rows]


def models(measured: Sequence[Kept]) -> dict[str, Curve]:
    """Return the curve through the measured figures of each name. The worst of ten e-stops depends on other load
    of the computer, so it has no model."""
    names = (MEDIAN, *PARTS)
    return {name: Curve.through(points_of(measured, name)) for name in names}


def points_of(measured: Sequence[Kept], name: str) -> list[tuple[float, float]]:
    """Return the numbers of robots for which a figure was measured, with the figure."""
    return [(each.figures["robots"], each.figures[name]) for each in measured if name in each.figures]


def write() -> None:
    """Write page and picture."""
    measured = kept()
    curves = models(measured)
    PAGE.write_text(page(measured, curves))
    draw(measured, curves, PICTURE)


def page(measured: Sequence[Kept], curves: Mapping[str, Curve]) -> str:
    """Return the text of the page."""
    head = ["robots", "", "median, ms", "worst of ten, ms", "missing outcomes", "settled, s"]
    head += [f"{name}, %" for name in PARTS.values()]
    rows = [row(head), row(["---"] * len(head))]
    for each in measured:
        values = [
            number(each.figures[name]) if name in each.figures else "–"
            for name in (MEDIAN, WORST, "missing_outcomes", "settled_s", *PARTS)
        ]
        rows.append(row([f"{each.figures['robots']:,.0f}", "measured", *values]))
    counts = {each.figures["robots"] for each in measured}
    for robots in MODELLED:
        if robots not in counts:
            parts = [number(curves[name].at(robots)) for name in PARTS]
            median = number(curves[MEDIAN].at(robots))
            rows.append(row([f"{robots:,}", "**model**", median, "–", "–", "–", *parts]))
    machine = measured[-1].machine
    where = "in network namespaces" if all(each.in_namespaces for each in measured) else "over loopback"
    loads = ", ".join(f"{each.machine.load_before:g}" for each in measured)
    measured_on = paragraph(
        f"{machine.processor}, {machine.cores} cores, {machine.kernel}, Python {machine.python}, "
        f"{machine.date[:10]}. Load before the runs: {loads}. All processes shared these cores, and the routers "
        f"with their robots were {where}."
    )
    model = {name: f"{curve.factor:.3g} · robots^{curve.power:.2f}" for name, curve in curves.items()}
    fits = [row(["figure", "model"]), row(["---", "---"])]
    fits.append(row(["time to the last outcome, median, ms", model[MEDIAN]]))
    fits += [row([f"processor, {label}, % of a core", model[name]]) for name, label in PARTS.items()]
    per_process = curves["metrics_pct"].reaches(80.0)
    return PAGE_TEXT.format(
        rows="\n".join(rows), measured_on=measured_on, fits="\n".join(fits), per_process=round(per_process, -1)
    )


def draw(measured: Sequence[Kept], curves: Mapping[str, Curve], path: Path) -> None:
    """Draw the measured figures as points, and the model as curves."""
    os.environ.setdefault("MPLBACKEND", "svg")
    import matplotlib

    matplotlib.rcParams["svg.hashsalt"] = path.name
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(8, 6), layout="constrained")
    panels = drawing.subplots(2, 1, sharex=True)
    steps = [10 * 10 ** (index / 20) for index in range(61)]
    for panel, labels, title in (
        (
            panels[0],
            {MEDIAN: "median of ten e-stops", WORST: "worst of ten"},
            "time from an e-stop to the last outcome, ms",
        ),
        (panels[1], PARTS, "processor time for telemetry, % of a core"),
    ):
        for name, label in labels.items():
            counts, figures = zip(*points_of(measured, name), strict=True)
            points = panel.plot(counts, [max(figure, 0.1) for figure in figures], "o", label=label)
            if name in curves:
                panel.plot(steps, [max(curves[name].at(x), 0.1) for x in steps], color=points[0].get_color(), lw=1)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_title(f"{title} (lower is better, logarithmic axes)", fontsize=10, loc="left")
        panel.grid(color="#e2e8f0", lw=0.8)
        panel.legend(fontsize=8)
    panels[1].axhline(100, color="grey", linestyle=":")
    panels[1].set_xlabel("robots (points are measured, curves are the model)")
    drawing.savefig(path, metadata={"Date": None})


PAGE_TEXT = """# Many robots

*Made by `python -m benchmarks.sides.scale --write` from `benchmarks/results/scale/`; do not edit.*

This page is about sites with many robots. It has the time from one e-stop until its sender knows the
outcome of every robot, the cost of the telemetry, and advice for the network of a site.

## Measurement

A stand-in publishes what an SO-101 publishes (`state` 10 Hz, `presence` 2 Hz, `health` 0.5 Hz), and
answers an e-stop as soon as it arrives. A stand-in has no processes of a robot, no wire and no arm.
So the figures show the mesh, and not the robots: the time until a real arm has its safe frame is
measured [separately](benchmarks.md). Up to 50 stand-ins connect to one zenoh router. These routers
connect to a central router. The program that orders the e-stop, one process of
[metrics](metrics.md) and one [console](console.md) with one open page connect to the central
router, and receive the telemetry of all robots.

{rows}

"Median" and "worst of ten" are the time from an e-stop to the last outcome, of ten e-stops.
"Settled" is the time from the appearance of the last robot, when all start together, until an e-stop
reached all of them. The processor time is in percent of one core. A row without it was measured
without metrics and console, so no telemetry was sent: two cores do not carry both for 1,000
stand-ins beside the routers, and no e-stop then reached all of them in time.

{measured_on}

![Time to the last outcome and processor time, by the number of robots](pictures/fleet.svg)

## The model

Rows with the word **model** were not measured. They come from a power law that was fitted to the
measured rows (least squares of the logarithms):

{fits}

The model has no limit of a core or of a link. Where it gives more than 100 % of a core for one
process, that process cannot serve so many robots: its telemetry would be late, and samples would be
dropped. A time that the model gives for such a number of robots holds only if the routers and the
program that orders the e-stop have a core each.

## Limits

* **Outcomes.** All robots answer an e-stop at the same moment, and one program reads all answers, one
  after the other. The stop itself does not wait for this: each robot stops when the order arrives.
  An outcome that arrives later than 250 ms is reported as `unreachable` by the functions with the
  usual patience; `estop(within_s=...)` waits longer.
* **Starts.** A router learns of a robot's subscriptions some time after the robot has appeared. If
  many robots start together on a busy computer, this takes seconds (column "settled"), and an e-stop
  before that does not reach all of them. The program that orders it reports the others as
  `unreachable`.
* **A router's links.** A link has room for 16 urgent messages. By default a router drops an answer
  that has no room for 1 ms, and the robot is then reported as unreachable, although it has stopped.
* **Metrics and console.** One process decodes the samples of all robots in Python. One process of
  the metrics can serve about {per_process:.0f} robots with 80 % of a core.
* **Rates.** The cost of telemetry is proportional to its rate and to the number of programs that
  subscribe. A topic without subscribers costs a robot nothing.
* **The computer.** Two cores carried all processes of these runs. So the times are longer than at a
  site, where each router and each group of robots has a separate computer, and grow faster than the
  number of robots.

## Set up a site

* One zenoh router for each group of at most 50 robots (a cell, a room), and a central router, to
  which the routers of the groups connect. Consoles and e-stop stations of a cell connect to the
  cell's router, so that its e-stop does not depend on the rest of the site.
* In the routers, set
  `transport/link/tx/queue/congestion_control/drop/wait_before_drop` to 100000 (microseconds). The
  benchmark sets it, and `--wait-us 1000` shows the default.
* Run one process of the metrics for each group, such as that of its [host](host.md). Prometheus
  collects from all of them.
* Keep groups apart by separate routers that are not connected, if one e-stop must not stop the whole
  site. An e-stop without a `target_id` stops every robot that it can reach.
* A program that joins with [certificates](mesh.md#the-toml-file) reaches each robot over a direct
  connection, and not through a router, because the certificate at the other end of a connection
  must be that of the robot. So routers are for networks that are protected in another way, such as a
  separate network of the site.

## Measure your own site

```sh
python -m benchmarks.sides.scale 10 50 100 300 --write
python -m benchmarks.sides.scale 1000 --estop-only --write
```

The command needs a checkout of the repository with the packages of its tests. It makes the network
namespaces itself if the kernel allows them to ordinary users (`unshare -rnm`), and otherwise uses
loopback. Use a computer without other load, with at least one core for each 100 stand-ins [assumed].
`python -m benchmarks fleet_estop` measures one e-stop to twelve complete arms with their twins.
"""

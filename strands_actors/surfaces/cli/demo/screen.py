"""The live display of the demo: processes, joints, frames to the arm, and events."""

from __future__ import annotations

import math
import time

import msgspec
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.layout import Layout
from rich.live import Live
from rich.measure import Measurement
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from strands_actors.kernel.clock import NS
from strands_actors.kernel.processes.process import state_of
from strands_actors.surfaces.cli.trees import draw

from .scenario import CONTROL_HZ, Scenario
from .story import Story
from .watch import Watch
from .wire import Wire

BAR_CELLS = 33
SPARKS = " ▁▂▃▄▅▆▇█"
SPARK_S = 0.2


class Screen:
    """The live display. It is shown while its ``with`` block runs."""

    def __init__(self, console: Console, watch: Watch, story: Story, scenario: Scenario) -> None:
        self._watch = watch
        self._story = story
        self._scenario = scenario
        self._span: list[tuple[float, float]] = []
        self._live = Live(
            get_renderable=self.render, console=console, screen=True, refresh_per_second=10, transient=True
        )

    def __enter__(self) -> Screen:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def render(self) -> RenderableType:
        layout = Layout()
        body, right = Layout(name="body"), Layout(ratio=3)
        joints = self._joints()
        right.split_column(
            Layout(joints, size=len(self._watch.axes) + 4 if self._watch.axes else 10),
            Layout(self._wire(), size=6),
            Layout(self._events()),
        )
        body.split_row(Layout(self._tree(), ratio=2), right)
        layout.split_column(Layout(self._head(), size=1), body)
        return layout

    def _head(self) -> RenderableType:
        head = Table.grid(expand=True)
        head.add_column()
        head.add_column(justify="right")
        head.add_row(
            Text.assemble((" strands-actors demo ", "bold white on blue"), f" {self._scenario.phase}"),
            Text(f"{self._story.seconds():.0f} s  Ctrl-C ends it ", "dim"),
        )
        return head

    def _tree(self) -> RenderableType:
        report = self._watch.tree
        if report is None:
            return Panel(Text("starting ...", "dim"), title="tree", title_align="left")
        states = {process.pid: state_of(process.pid) for process in report.processes}
        status = self._watch.status
        mode = "no wire process" if status is None else status.mode
        epoch = report.epoch if status is None else status.epoch
        now = msgspec.structs.replace(report, state=mode, epoch=epoch)
        cause = "" if status is None or not status.cause else f"because: {status.cause}"
        return Panel(
            Group(draw(now, states, introspection=False), Text(), Text(cause, "dim")),
            title="tree",
            title_align="left",
        )

    def _joints(self) -> RenderableType:
        table = Table(box=None, expand=True, padding=(0, 1), header_style="dim")
        table.add_column("joint")
        table.add_column("is", justify="right")
        table.add_column("target", justify="right")
        table.add_column("")
        watch = self._watch
        if watch.positions:
            position = watch.positions[-1].values
            target = watch.targets[-1].values if watch.moving and watch.targets else None
            self._span = self._span or [(value, value) for value in position]
            for index, axis in enumerate(watch.axes):
                value, aim = position[index], None if target is None else target[index]
                table.add_row(
                    axis, f"{value:.1f}", "-" if aim is None else f"{aim:.1f}", self._bar(index, value, aim)
                )
        return Panel(table, title=f"joints: {self._watch.unit}", title_align="left")

    def _bar(self, index: int, value: float, aim: float | None) -> RenderableType:
        """Return a bar that shows a joint's position and target. Its ends are the smallest and largest
        position so far, with a margin."""
        low, high = self._span[index]
        values = [value - 5, value + 5] if aim is None else [value - 5, value + 5, aim]
        self._span[index] = low, high = min(low, *values), max(high, *values)
        marks = [] if aim is None else [((aim - low) / (high - low), "◇", "yellow")]
        marks.append(((value - low) / (high - low), "●", "bold green" if marks else "bold cyan"))
        return _Bar(marks)

    def _wire(self) -> RenderableType:
        watch, now_ns = self._watch, time.monotonic_ns()
        status = watch.status
        if status is None or status.observation is None:
            age = Text("none", "bold red")
        else:
            age_ms = (now_ns - status.observation.t_ns) / 1e6
            age = Text(f"{age_ms:.0f} ms", "" if age_ms < 300 else "bold red")
        last = watch.wire.last("setpoint", "safe", "enable")
        word = "nothing yet" if last is None else f"{last.kind} {(now_ns - last.t_ns) / NS:.1f} s ago"
        grid = Table.grid(padding=(0, 2), expand=True)
        grid.add_column(ratio=1)
        grid.add_column(ratio=1)
        grid.add_row(
            f"{watch.wire.frames_per_s(now_ns):.0f} frames/s",
            Text("observation: ").append_text(age),
        )
        setpoints = len(watch.wire.setpoint_times_ns(now_ns - NS, now_ns))
        grid.add_row(f"{setpoints} setpoints/s", f"last: {word}")
        sparks = _Sparkline(watch.wire, now_ns)
        return Panel(Group(grid, Text(), sparks), title="wire, as the twin heard it", title_align="left")

    def _events(self) -> RenderableType:
        return Panel(_Tail(self._story.lines), title="so far", title_align="left")


class _Bar:
    """A line with marks, as wide as the column. A mark is (place from 0 to 1, character, style)."""

    def __init__(self, marks: list[tuple[float, str, str]]) -> None:
        self._marks = marks

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = max(2, min(options.max_width, BAR_CELLS))
        cells = [("·", "bright_black")] * width
        for place, sign, style in self._marks:
            cells[round(place * (width - 1))] = sign, style
        yield Text.assemble(*cells)

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        return Measurement(4, BAR_CELLS)


class _Sparkline:
    """A chart of the setpoints that were sent during the last seconds. A block of half height
    means that setpoints were sent at the control rate."""

    def __init__(self, wire: Wire, now_ns: int) -> None:
        self._wire = wire
        self._now_ns = now_ns

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        title = "setpoints "
        step_ns, cells = round(SPARK_S * NS), options.max_width - len(title)
        until_ns = self._now_ns // step_ns * step_ns
        since_ns = until_ns - cells * step_ns
        counts = [0] * cells
        for t_ns in self._wire.setpoint_times_ns(since_ns, until_ns):
            counts[(t_ns - since_ns) // step_ns] += 1
        half = CONTROL_HZ * SPARK_S
        blocks = (SPARKS[min(8, math.ceil(4 * count / half - 0.25))] for count in counts)
        yield Text.assemble((title, "dim"), ("".join(blocks), "green"))


class _Tail:
    """The last lines of the events, as many as fit."""

    def __init__(self, lines: list[Text]) -> None:
        self._lines = lines

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        room = options.height or options.max_height
        for line in self._lines[-room:]:
            short = line.copy()
            short.truncate(options.max_width, overflow="ellipsis")
            yield short

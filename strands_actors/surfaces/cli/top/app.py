"""The screen of ``top``: a line for each robot, and the processes and state of the selected robot."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable
from typing import ClassVar

from rich.console import Group
from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, VerticalScroll
from textual.events import Resize
from textual.screen import ModalScreen
from textual.widgets import DataTable, Footer, Static

from strands_actors.surfaces.cli.trees import draw

from .feed import Feed, RobotSnapshot
from .rows import Columns, Rates, columns_for, facts, heading, row

MOST_RESULTS = 4
"""Number of results that stay on the screen."""

EMPTY = Text.assemble(
    "No robot of this user is running.\n\n",
    ("Start one in another terminal, for example with ", "dim"),
    "strands-actors demo",
    (". It appears here by itself.", "dim"),
)


class Confirm(ModalScreen[bool]):
    """A dialog that asks the user whether to energise a robot.

    The keys for a stop and an e-stop work here, too. Both call the function ``stop``, with the text ``stop`` or
    ``e-stop``.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y,enter", "answer(True)", "energise"),
        Binding("n,escape,q", "answer(False)", "leave it"),
        Binding("s,space", "instead('stop')", "stop"),
        Binding("e", "instead('e-stop')", "e-stop (locks)"),
    ]

    def __init__(self, robot: str, locked_by: str, stop: Callable[[str], None]) -> None:
        super().__init__()
        self._robot = robot
        self._locked_by = locked_by
        self._stop = stop

    def compose(self) -> ComposeResult:
        lift = f"Lift the e-stop by {self._locked_by}, and energise " if self._locked_by else "Energise "
        question = Text.assemble(
            lift,
            (self._robot, "bold"),
            " at its measured position? It starts no motion.\n\n",
            ("y", "bold"),
            " energise    ",
            ("n", "bold"),
            " leave it    ",
            ("s", "bold"),
            " stop    ",
            ("e", "bold"),
            " e-stop",
        )
        yield Static(question, id="question")

    def action_answer(self, yes: bool) -> None:
        self.dismiss(yes)

    def action_instead(self, verb: str) -> None:
        self._stop(verb)  # Send the stop before changing the screen, which takes time.
        self.dismiss(False)


class Top(App[None]):
    """The application. The key ``s`` stops the selected robot at once."""

    ENABLE_COMMAND_PALETTE = False
    CSS = """
    Screen { background: $background; }
    #head { height: 1; padding: 0 1; background: $panel; }
    #robots { height: auto; max-height: 40%; overflow-x: hidden; background: $background; }
    #empty { height: 1fr; padding: 2 3; display: none; }
    #page { height: 1fr; border-top: solid $panel; }
    #tree-scroll { width: 1fr; max-width: 58; padding: 0 1; }
    #facts-scroll { width: 1fr; padding: 0 1; border-left: solid $panel; }
    #results { height: auto; max-height: 4; padding: 0 1; border-top: solid $panel; }
    Confirm { align: center middle; }
    #question { width: 60; height: auto; padding: 1 3; border: round $primary; background: $panel; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("s,space", "ask('stop')", "stop", key_display="s"),
        Binding("e", "ask('e-stop')", "e-stop (locks)"),
        Binding("r", "resume", "resume"),
        Binding("up,k", "move(-1)", "select", key_display="↑↓", priority=True),
        Binding("down,j", "move(1)", "select", show=False, priority=True),
        Binding("q", "quit", "quit"),
        Binding("ctrl+c", "quit", "quit", show=False, priority=True),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._feed = Feed(self._show_soon, self._tell_soon)
        self._snapshots: list[RobotSnapshot] = []
        self._columns: Columns = ()
        self._rates: dict[str, Rates] = {}
        self._results: deque[Text] = deque(maxlen=MOST_RESULTS)

    def compose(self) -> ComposeResult:
        yield Static(id="head")
        yield DataTable(id="robots", cursor_type="row", zebra_stripes=False)
        yield Static(EMPTY, id="empty")
        with Horizontal(id="page"):
            with VerticalScroll(id="tree-scroll", can_focus=False):
                yield Static(id="tree")
            with VerticalScroll(id="facts-scroll", can_focus=False):
                yield Static(id="facts")
        yield Static(id="results")
        yield Footer(show_command_palette=False)

    def on_mount(self) -> None:
        self._table.focus()
        self.query_one("#results").display = False
        self._feed.start()

    def on_unmount(self) -> None:
        self._feed.close()

    def leave(self, code: int) -> None:
        """End the application with an exit code. Any thread may call this."""
        self._soon(self.exit, None, code)

    def on_resize(self, event: Resize) -> None:
        columns = columns_for(event.size.width)
        if columns == self._columns:
            return
        snapshots, row = self._snapshots, self._table.cursor_row
        self._columns, self._snapshots = columns, []
        self._table.clear(columns=True)
        for title, width in columns:
            self._table.add_column(heading(title, width), key=title, width=width)
        if snapshots:
            self._show(snapshots)
            self._table.move_cursor(row=row)

    # -- called from the feed's thread

    def _show_soon(self, snapshots: list[RobotSnapshot]) -> None:
        self._soon(self._show, snapshots)

    def _tell_soon(self, line: str, done: bool) -> None:
        self._soon(self._tell, line, done)

    def _soon(self, function: object, *args: object) -> None:
        loop = self._loop
        if loop is not None and self._running:
            with contextlib.suppress(RuntimeError):  # The event loop may just have ended.
                loop.call_soon_threadsafe(function, *args)  # type: ignore[arg-type]

    # -- draw the screen

    @property
    def _table(self) -> DataTable[Text]:
        return self.query_one("#robots", DataTable)

    @property
    def selected(self) -> RobotSnapshot | None:
        """The robot in the selected line. The keys act on it."""
        row = self._table.cursor_row
        return self._snapshots[row] if 0 <= row < len(self._snapshots) else None

    def _show(self, snapshots: list[RobotSnapshot]) -> None:
        table, before = self._table, self.selected
        names = [each.note.robot for each in snapshots]
        if names != [each.note.robot for each in self._snapshots]:
            table.clear()
            for name in names:
                table.add_row(*([Text()] * len(self._columns)), key=name)
            if before is not None and before.note.robot in names:
                table.move_cursor(row=names.index(before.note.robot))
        self._snapshots = snapshots
        self._rates = {name: self._rates.get(name) or Rates() for name in names}
        for each in snapshots:
            rates = self._rates[each.note.robot]
            rates.add(each)
            cells = row(each, rates, self._columns)
            for (title, _), cell in zip(self._columns, cells, strict=True):
                table.update_cell(each.note.robot, title, cell)
        self._show_head()
        self._show_page()

    def _show_head(self) -> None:
        count = len(self._snapshots)
        robots = "1 robot" if count == 1 else f"{count} robots"
        head = Text.assemble(
            ("strands-actors top", "bold"), ("   " + robots, ""), "   ", (time.strftime("%H:%M:%S"), "dim")
        )
        self.query_one("#head", Static).update(head)

    def _show_page(self) -> None:
        selected = self.selected
        for name in ("#robots", "#page"):
            self.query_one(name).display = bool(self._snapshots)
        self.query_one("#empty").display = not self._snapshots
        if selected is not None:
            self.query_one("#tree", Static).update(draw(selected.tree, selected.processes, introspection=False))
            self.query_one("#facts", Static).update(facts(selected))

    def _tell(self, line: str, done: bool) -> None:
        self._results.append(
            Text.assemble((time.strftime("%H:%M:%S  "), "dim"), (line, "" if done else "bold red"))
        )
        results = self.query_one("#results", Static)
        results.display = True
        results.update(Group(*self._results))

    # -- keys

    def on_data_table_row_highlighted(self) -> None:
        self._show_page()

    def action_move(self, by: int) -> None:
        if not isinstance(self.screen, Confirm):
            self._table.move_cursor(row=max(0, min(len(self._snapshots) - 1, self._table.cursor_row + by)))

    def action_ask(self, verb: str) -> None:
        """Send a stop or an e-stop to the selected robot at once, without a confirmation."""
        if self.selected is not None:
            self._feed.ask(verb, self.selected.note.robot)

    def action_resume(self) -> None:
        if self.selected is None:
            return
        robot, status = self.selected.note.robot, self.selected.status

        def go_on(yes: bool | None) -> None:
            if yes:
                self._feed.ask("resume", robot)

        locked_by = status.locked_by if status else ""
        self.push_screen(Confirm(robot, locked_by, lambda verb: self._feed.ask(verb, robot)), go_on)

"""Test ``top``: what it shows of running robots, and that its keys reach them."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import select
import signal
import struct
import subprocess
import termios
import time
from collections.abc import Awaitable, Callable, Iterator
from fcntl import ioctl
from typing import Any

import pytest
from textual.pilot import Pilot

from strands_actors.surfaces.cli.top.app import Confirm, Top
from strands_actors.surfaces.cli.top.rows import COLUMNS, columns_for
from tests import answers
from tests.cli.command import PATIENCE_S, Command, RobotProcess, refusal_code
from tests.cli.terminal import ALT_SCREEN_OFF, Terminal

MOVE = {"shoulder_pan": 3.0}
SIZE = (120, 36)
CTRL_C = b"\x03"

Script = Callable[[Top, Pilot[None]], Awaitable[None]]


def on_screen(cli: Command, monkeypatch: pytest.MonkeyPatch, script: Script) -> None:
    """Run a script against the app, in the environment of ``cli``."""
    monkeypatch.setenv("STRANDS_ACTORS_RUN", cli.environment["STRANDS_ACTORS_RUN"])

    async def run() -> None:
        app = Top()
        async with app.run_test(size=SIZE) as pilot:
            await script(app, pilot)

    asyncio.run(run())


async def until(pilot: Pilot[None], look: Callable[[], bool], what: str) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not look():
        notes = [note.message for note in pilot.app._notifications]
        assert time.monotonic() < deadline_s, f"not on the screen: {what}. It shows {notes}"
        await pilot.pause(0.02)


def rows(app: Top) -> dict[str, dict[str, str]]:
    """Return the table's cells by robot and column."""
    table: Any = app.query_one("#robots")
    found = {}
    for at in range(table.row_count):
        cells = dict(
            zip((title for title, _ in COLUMNS), (cell.plain.strip() for cell in table.get_row_at(at)), strict=True)
        )
        found[cells["robot"]] = cells
    return found


def state(app: Top, robot: str = "so101") -> str:
    return rows(app).get(robot, {}).get("state", "")


def test_top_without_a_running_robot_ignores_keys_and_quits(cli: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(app: Top, pilot: Pilot[None]) -> None:
        await until(pilot, lambda: app.query_one("#empty").display, "that nobody is there")
        for key in ("s", "e", "r", "down", "up"):
            await pilot.press(key)
        assert not isinstance(app.screen, Confirm)
        await pilot.press("q")

    on_screen(cli, monkeypatch, script)


@pytest.mark.long
def test_a_robot_appears_is_stopped_locked_resumed_and_leaves(
    cli: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def script(app: Top, pilot: Pilot[None]) -> None:
        await until(pilot, lambda: app.query_one("#empty").display, "that nobody is there")
        with contextlib.ExitStack() as stack:
            robot = await asyncio.to_thread(stack.enter_context, RobotProcess(cli))
            assert robot.call("send_action", {"shoulder_pan": 999.0})["status"] == "error"
            await until(pilot, lambda: state(app) == "armed", "an armed robot")
            await until(pilot, lambda: rows(app)["so101"]["reads/s"] not in ("–", "0"), "its rate")
            cells = rows(app)["so101"]
            assert cells["lease"] == f"so101 ({robot.process.pid})"
            assert cells["refused"] == "1"
            assert cells["restarts"] == "0"
            assert cells["age"].endswith("ms")
            assert app.selected is not None
            assert app.selected.status is not None
            assert "999" in app.selected.status.last_refusal

            await pilot.press("s")
            await until(pilot, lambda: state(app) == "disarmed", "the stop")
            assert refusal_code(robot.call("send_action", MOVE)) == "disarmed"

            await pilot.press("e")
            await until(pilot, lambda: state(app) == "e-stopped", "the e-stop")
            assert refusal_code(robot.call("send_action", MOVE)) == "locked_out"

            await pilot.press("r")
            await until(pilot, lambda: isinstance(app.screen, Confirm), "the question")
            await pilot.press("n")
            await until(pilot, lambda: not isinstance(app.screen, Confirm), "that the question was answered")
            assert refusal_code(robot.call("send_action", MOVE)) == "locked_out"
            await pilot.press("r")
            await until(pilot, lambda: isinstance(app.screen, Confirm), "the question, again")
            await pilot.press("y")
            await until(pilot, lambda: state(app) == "armed", "the resume")
            assert robot.call("send_action", MOVE)["status"] == "success"

            for process in app.selected.tree.processes:
                if process.role == "root":
                    os.kill(process.pid, signal.SIGSTOP)
            await until(pilot, lambda: state(app) in ("unreachable", "disarmed"), "that its root is frozen")
            await until(
                pilot, lambda: "frozen" in app.selected.processes.values() if app.selected else False, "why"
            )
            assert robot.call("resume")["status"] == "success"
        await until(pilot, lambda: not rows(app), "that it has left")

    on_screen(cli, monkeypatch, script)


@pytest.mark.long
def test_a_question_takes_no_stop_away(cli: Command, robot: RobotProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(app: Top, pilot: Pilot[None]) -> None:
        await until(pilot, lambda: state(app) == "armed", "an armed robot")
        for key, became in (("s", "disarmed"), ("space", "disarmed"), ("e", "e-stopped")):
            await pilot.press("r")
            await until(pilot, lambda: isinstance(app.screen, Confirm), "the question")
            await pilot.press(key)
            await until(pilot, lambda wanted=became: state(app) == wanted, f"the {key} beneath the question")
            assert not isinstance(app.screen, Confirm)
            if became == "disarmed":
                assert (await asyncio.to_thread(robot.call, "resume"))["status"] == "success"
                await until(pilot, lambda: state(app) == "armed", "an armed robot")

    on_screen(cli, monkeypatch, script)


def test_keys_act_on_the_selected_robot_only(
    cli: Command, robot: RobotProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    with RobotProcess(cli):

        async def script(app: Top, pilot: Pilot[None]) -> None:
            await until(pilot, lambda: [state(app, name) for name in rows(app)] == ["armed"] * 2, "two robots")
            await pilot.press("down", "s")
            await until(pilot, lambda: state(app, "so101-2") == "disarmed", "the stop")
            assert state(app, "so101") == "armed"
            await pilot.press("up")
            assert app.selected is not None
            assert app.selected.note.robot == "so101"

        on_screen(cli, monkeypatch, script)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(("how", "code"), [("key", 0), (signal.SIGTERM, 143)])
def test_in_a_terminal_it_stops_a_robot_and_leaves_the_terminal_as_it_was(
    cli: Command, robot: RobotProcess, how: signal.Signals | str, code: int
) -> None:
    with Terminal(cli, "top", rows=36) as terminal:
        shown = terminal.shown
        answers.until(lambda: b"so101" in shown and b"armed" in shown, "the robot is shown", PATIENCE_S)
        terminal.press(b"s")
        answers.until(lambda: b"motors confirmed" in shown, "the stop is reported", PATIENCE_S)
        assert refusal_code(robot.call("send_action", MOVE)) == "disarmed"
        if isinstance(how, str):
            terminal.press(CTRL_C)
        else:
            terminal.process.send_signal(how)
        assert terminal.process.wait(PATIENCE_S) == code
        assert terminal.settings() == terminal.settings_before
    assert ALT_SCREEN_OFF in shown
    assert b"Traceback" not in shown


def test_a_narrow_screen_goes_without_the_least_important() -> None:
    every = [title for title, _ in COLUMNS]
    for width in range(60, 200):
        columns = columns_for(width)
        titles = [title for title, _ in columns]
        assert {"robot", "state", "writes/s", "reads/s", "age"} <= set(titles)
        assert titles == [title for title in every if title in titles]
        if width >= 80:
            assert sum(size + 2 for _, size in columns) <= width
    assert [title for title, _ in columns_for(120)] == every
    assert "restarts" in dict(columns_for(80))
    assert dict(columns_for(120))["lease"] >= 12


def test_without_a_terminal_top_names_the_alternative(cli: Command) -> None:
    done = cli.run("top")
    assert done.returncode == 2
    assert (
        done.stderr == "strands-actors: top: this needs a terminal. "
        "Use `strands-actors tree`, which prints the robots once\n"
    )


@pytest.fixture
def shown_in_a_terminal(cli: Command) -> Iterator[tuple[subprocess.Popen[str], int, int]]:
    """Run ``top`` in a terminal, and yield the process with both ends. It is no controlling terminal, so no
    signal reports that it is gone."""
    screen, terminal = pty.openpty()
    ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 36, 120, 0, 0))
    cli.environment["TERM"] = "xterm-256color"
    streams = dict.fromkeys(("stdin", "stdout", "stderr"), terminal)
    process = cli.start("top", start_new_session=True, **streams)
    shown = b""
    try:
        while b"No robot of this user" not in shown:
            assert select.select([screen], [], [], PATIENCE_S)[0], shown
            shown += os.read(screen, 65536)
        yield process, screen, terminal
    finally:
        process.kill()
        process.wait()
        for fd in (screen, terminal):
            with contextlib.suppress(OSError):
                os.close(fd)


LEAVES_S = 10.0
"""Timeout, far above the usual time, for a busy machine. An earlier version never ended."""


def test_saf_015_it_ends_with_its_terminal(shown_in_a_terminal: tuple[subprocess.Popen[str], int, int]) -> None:
    process, screen, terminal = shown_in_a_terminal
    os.close(terminal)
    os.close(screen)
    assert process.wait(LEAVES_S) == 128 + signal.SIGHUP


def test_saf_015_top_ends_by_a_signal_when_its_terminal_is_not_read(
    shown_in_a_terminal: tuple[subprocess.Popen[str], int, int],
) -> None:
    process, _, terminal = shown_in_a_terminal
    termios.tcflow(terminal, termios.TCOOFF)
    time.sleep(0.5)
    process.send_signal(signal.SIGTERM)
    assert process.wait(LEAVES_S) == 128 + signal.SIGTERM

"""Run the demo as a user does. Its exit code shows whether the robot was safe, and no process or file is left."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

from tests.answers import until

from .command import PATIENCE_S, Command
from .terminal import ALT_SCREEN_OFF, Terminal

CURSOR_ON = b"\x1b[?25h"


def test_every_fault_is_followed_by_the_safe_state(cli: Command, tmp_path: Path) -> None:
    done = cli.run("demo", "--json", "--seconds", "6", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(done.stdout)  # one object and nothing else
    assert result["ok"] is True
    faults = {(fault["fault"], fault["victim"]): fault for fault in result["faults"]}
    assert list(faults) == [("SIGKILL", "policy"), ("SIGKILL", "wire"), ("SIGSTOP", "root")]
    assert [fault["safe_state"] for fault in faults.values()] == ["hold", "limp", "limp"]
    assert [fault["bound_ms"] for fault in faults.values()] == [50, 50, 150]
    for fault in faults.values():
        assert 0 < fault["safe_after_ms"] <= fault["bound_ms"]
        assert fault["setpoints_after"] == 0
        assert fault["watched_s"] > 0.3
        assert fault["restarted"]
        assert fault["rearmed"]
        assert fault["safe"]
    picture = (tmp_path / "demo.png").read_bytes()
    assert picture.startswith(b"\x89PNG\r\n\x1a\n")
    assert picture.endswith(b"IEND\xaeB`\x82")
    assert len(picture) > 20_000
    assert cli.processes() == []


@pytest.mark.long
def test_without_faults_it_reports_the_pace(cli: Command, tmp_path: Path) -> None:
    done = cli.run("demo", "--no-faults", "--seconds", "6", "--out", "wave.png", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "\x1b" not in done.stdout, "no terminal: plain lines"
    assert "policy at" in done.stdout
    assert "between setpoints" in done.stdout
    assert "SIG" not in done.stdout
    assert (tmp_path / "wave.png").stat().st_size > 20_000


def test_ctrl_c_leaves_a_sane_terminal_and_no_process(cli: Command, tmp_path: Path) -> None:
    with Terminal(cli, "demo", cwd=tmp_path) as terminal:
        until(lambda: b"sine policy runs" in terminal.shown, "the arm moves", PATIENCE_S)
        terminal.process.send_signal(signal.SIGINT)
        assert terminal.process.wait(PATIENCE_S) == 130
    shown = terminal.shown
    assert ALT_SCREEN_OFF in shown
    assert CURSOR_ON in shown[shown.index(ALT_SCREEN_OFF) - 20 :]
    assert b"Traceback" not in shown
    cli.wait_until_gone()

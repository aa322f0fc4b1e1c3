"""Test the wire log while a twin writes and a test reads it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from strands_actors.drivers.common.twin import WireLog as Writer
from strands_actors.testing import WireLog


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "wire.ndjson"


def test_new_entries_are_read_once_and_kept(path: Path) -> None:
    log = WireLog(path)
    assert list(log.entries()) == [], "a log without a file has no entries"
    writer = Writer(str(path))
    writer.write(1, "host", [("setpoint", b"\x01")])
    (setpoint,) = log.entries()
    assert (setpoint.t_ns, setpoint.sender, setpoint.kind, setpoint.data) == (1, "host", "setpoint", b"\x01")
    assert setpoint.safe_state is None
    writer.write(5, "host", [("safe", b"\x02")], "limp")
    writer.write(6, "robot", [("read", b"\x03")])
    assert [entry.kind for entry in log.entries()] == ["setpoint", "safe", "read"]
    assert [entry.kind for entry in log.entries(5)] == ["safe", "read"]
    assert [entry.safe_state for entry in log.host("safe")] == ["limp"]


def test_half_a_line_is_read_when_it_is_whole(path: Path) -> None:
    log = WireLog(path)
    Writer(str(path)).write(1, "host", [("safe", b"\x02")], "hold")
    line = path.read_bytes()
    path.write_bytes(line + line[:20])
    assert len(list(log.entries())) == 1
    path.write_bytes(line + line)
    assert len(list(log.entries())) == 2


@pytest.mark.parametrize("frames", [0, 1, 9])
def test_an_emptied_log_keeps_nothing(path: Path, frames: int) -> None:
    """This holds however much was written since, without a reader."""
    log, writer = WireLog(path), Writer(str(path))
    for t_ns in range(5):
        writer.write(t_ns, "host", [("setpoint", b"\x01")])
    assert len(list(log.entries())) == 5
    before = log.entries()
    os.truncate(path, 0)
    for t_ns in range(100, 100 + frames):
        writer.write(t_ns, "host", [("safe", b"\x02")], "hold")
    assert [entry.t_ns for entry in log.entries()] == list(range(100, 100 + frames))
    assert [entry.t_ns for entry in before] == list(range(5)), "an earlier iterator does not yield new entries"

"""What the benchmarks of robots make of a wire log, and of a peer that is missing."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from benchmarks import peers
from benchmarks.sides.wire import Log, delays_us, percentile


def test_a_setpoint_is_timed_to_the_first_frame_that_says_something_new(tmp_path: Path) -> None:
    path = tmp_path / "wire.ndjson"

    def frame(t_ns: int, data: str) -> None:
        with path.open("a") as file:
            file.write(json.dumps({"t_ns": t_ns, "from": "host", "kind": "setpoint", "hex": data}) + "\n")

    def send(number: int) -> int:
        began_ns = time.monotonic_ns()
        frame(began_ns + 1_000, f"{number:02x}")  # the last target, sent again
        frame(began_ns + 500_000, f"{number + 1:02x}")
        return began_ns

    frame(1, "00")
    assert delays_us(send, Log(str(path)), 5, pause_s=0.001) == [500.0] * 5


def test_a_log_is_read_up_to_its_last_whole_line(tmp_path: Path) -> None:
    path = tmp_path / "wire.ndjson"
    line = json.dumps({"t_ns": 5, "from": "host", "kind": "safe", "hex": "ff"})
    path.write_text(f"{line}\n{line[:20]}")
    log = Log(str(path))
    assert len(log.read()) == 1
    with path.open("a") as file:
        file.write(f"{line[20:]}\n")
    assert len(log.read()) == 2
    assert log.first("safe", 5, 0.0) is not None
    assert log.first("safe", 6, 0.0) is None


def test_percentiles_are_values_that_were_measured() -> None:
    assert percentile([3.0, 1.0, 2.0], 0.5) == 2.0
    assert percentile([3.0, 1.0, 2.0], 1.0) == 3.0


def test_a_peer_that_is_missing_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(peers, "PLACE", tmp_path)
    with pytest.raises(peers.Missing, match=r"run python -m benchmarks\.peers strands"):
        peers.python("strands")
    with pytest.raises(peers.Missing, match=r"no Python 2\.1 "):
        peers.find("2.1")

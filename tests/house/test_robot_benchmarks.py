"""The benchmarks of robots: figures from a wire log, and the message for a missing peer."""

from __future__ import annotations

import json
import socket
import struct
import time
from pathlib import Path

import pytest

from benchmarks import peers, wires
from benchmarks.house import OURS
from benchmarks.sides.late_answers import LATE_S
from benchmarks.sides.wire import Frame, Log, delays_us, percentile
from benchmarks.sides.wires import TARGET_READERS, is_safe
from strands_actors.drivers.kinova import protocol as kinova
from tests.answers import PATIENCE_S


def test_a_setpoint_is_timed_to_the_first_frame_with_a_new_target(tmp_path: Path) -> None:
    path = tmp_path / "wire.ndjson"

    def frame(t_ns: int, data: str) -> None:
        with path.open("a") as file:
            file.write(json.dumps({"t_ns": t_ns, "from": "host", "kind": "setpoint", "hex": data}) + "\n")

    def send(number: int) -> int:
        began_ns = time.monotonic_ns()
        frame(began_ns + 1_000, f"{number:02x}")  # the last target, repeated
        frame(began_ns + 500_000, f"{number + 1:02x}")
        return began_ns

    frame(1, "00")
    assert delays_us(send, Log(str(path)), 5, pause_s=0.001) == [500.0] * 5


def test_a_log_is_read_up_to_its_last_complete_line(tmp_path: Path) -> None:
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


def test_a_missing_peer_is_reported_with_a_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(peers, "PLACE", tmp_path)
    with pytest.raises(peers.Missing, match=r"run python -m benchmarks\.peers strands"):
        peers.python("strands")
    with pytest.raises(peers.Missing, match=r"no Python 2\.1 "):
        peers.find("2.1")


def setpoint(data: bytes) -> Frame:
    return Frame(0, "setpoint", data.hex())


def test_a_counter_that_differs_in_every_frame_is_not_a_new_target() -> None:
    xarm = TARGET_READERS["xarm7"]
    assert xarm(setpoint(b"\0\1rest")) == xarm(setpoint(b"\0\2rest")) != xarm(setpoint(b"\0\2more"))
    iiwa = TARGET_READERS["kuka_iiwa"]
    targets = [setpoint(b"\x0a\x3f\x09" + struct.pack("<d", rad)) for rad in (0.004, 0.004 + 1e-9, 0.005)]
    assert iiwa(targets[0]) == iiwa(targets[1]) != iiwa(targets[2])
    move, recover = (Frame(0, "enable", f"{command}000000") for command in ("01", "05"))
    assert TARGET_READERS["panda"](move) and TARGET_READERS["panda"](recover) is None


@pytest.mark.parametrize(("deg_s", "quick"), [(0.0, False), (2.0, False), (-20.0, True)])
def test_a_kinova_has_a_new_target_when_its_first_joint_is_quick(deg_s: float, quick: bool) -> None:
    speeds = kinova.encode_speeds((deg_s, *(0.0,) * 6))
    assert TARGET_READERS["kinova_gen3"](setpoint(speeds)) is quick


def test_a_hover_and_the_end_of_a_move_count_as_stops_of_clients() -> None:
    hover, flies = (
        b"\x7c\x0a" + struct.pack("<ffff", 0, 0, 0, 0.5),
        b"\x7c\x0a" + struct.pack("<ffff", 0.1, 0, 0, 0.5),
    )
    assert is_safe(setpoint(hover)) and not is_safe(setpoint(flies))
    assert is_safe(Frame(0, "other", b"POST /api/move/stop HTTP/1.1".hex()))


def test_answers_are_late_and_requests_are_not(tmp_path: Path) -> None:
    flag = tmp_path / "late"
    with socket.create_server(("127.0.0.1", 0)) as service:
        port = f"127.0.0.1:{service.getsockname()[1]}"
        with wires.LateLine(port, tmp_path, flag) as line:
            host, _, number = line.port.rpartition(":")
            with socket.create_connection((host, int(number)), PATIENCE_S) as client, service.accept()[0] as served:
                flag.touch()
                client.sendall(b"?")
                assert served.recv(1) == b"?"
                began_s = time.monotonic()
                served.sendall(b"!")
                assert client.recv(1) == b"!"
                assert time.monotonic() - began_s >= LATE_S
                served.close()
                assert client.recv(1) == b""


@pytest.mark.long
def test_the_short_form_of_a_wire_gives_the_figures_that_its_goals_judge() -> None:
    found = wires.run_with_twin("xarm7", OURS, "short")
    assert {f"xarm7_{figure}" for figure in found} >= {goal.figure for goal in wires.goals_of("xarm7")}
    assert all(value > 0 for figure, value in found.items() if not figure.endswith("pct"))

"""``twin`` serves the robot's end of the wire until it is interrupted, and ``twin-order`` changes it meanwhile."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
import serial

from strands_actors.drivers.feetech import protocol
from strands_actors.surfaces.cli import run
from strands_actors.testing import move_by_hand
from tests.answers import until

from .command import PATIENCE_S, Command


@pytest.mark.parametrize("interrupt", [signal.SIGINT, signal.SIGTERM])
def test_port_log_fault_and_end(cli: Command, tmp_path: Path, interrupt: signal.Signals) -> None:
    port_file, log = tmp_path / "port", tmp_path / "wire.ndjson"
    arguments = ["twin", "so_arm101", "--port-file", str(port_file), "--log", str(log), "--fault", "off:3"]
    with cli.start(*arguments) as twin:
        until(port_file.exists, "the twin serves", PATIENCE_S)
        with serial.Serial(port_file.read_text(), 1_000_000, timeout=PATIENCE_S) as port:
            port.write(protocol.ping(3) + protocol.ping(4))
            assert port.read(6) == protocol.frame(4, 0)  # servo 3 has no power
        twin.send_signal(interrupt)
        out, err = twin.communicate(timeout=PATIENCE_S)
    assert (twin.returncode, out, err) == (0, "", "")
    assert not port_file.exists()
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert [(line["from"], line["kind"]) for line in lines] == [("host", "read")] * 2 + [("robot", "read")]
    assert all(list(line) == ["t_ns", "from", "kind", "hex"] for line in lines)


def test_orders_unplug_and_plug_a_running_twin_and_wrong_ones_are_refused(
    cli: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port_file = tmp_path / ("a-long-name-" * 12) / "port"  # longer than the path of a socket may be
    port_file.parent.mkdir()
    with cli.start("twin", "unitree_g1", "--port-file", str(port_file)) as twin:
        until(port_file.exists, "the twin serves", PATIENCE_S)
        orders = Path(f"{port_file}.orders")
        assert orders.is_socket() and orders.stat().st_mode & 0o077 == 0
        for order in (["battery", "40"], ["fault", "stuck"], ["fault", "ok"], ["freeze", "0.1"]):
            assert (run(["twin-order", str(port_file), *order]), capsys.readouterr().err) == (0, "")
        assert run(["twin-order", str(port_file), "dance"]) == 2
        assert "unknown control line 'dance'. Use fault WORD" in capsys.readouterr().err
        assert run(["twin-order", str(port_file), "fault", "sulk"]) == 2
        assert "sulk" in capsys.readouterr().err
        twin.send_signal(signal.SIGTERM)
        twin.communicate(timeout=PATIENCE_S)
    assert list(port_file.parent.iterdir()) == []
    assert run(["twin-order", str(port_file), "plug"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "no twin takes orders at" in error and "Start one: strands-actors twin" in error


def test_the_cable_of_a_twin_is_pulled_and_its_joints_are_moved_by_hand(cli: Command, tmp_path: Path) -> None:
    port_file, control = tmp_path / "port", tmp_path / "control"
    arguments = ["twin", "so101", "--port-file", str(port_file), "--control", str(control)]
    with cli.start(*arguments) as twin:
        until(port_file.exists, "the twin serves", PATIENCE_S)
        port = Path(port_file.read_text())
        assert run(["twin-order", str(port_file), "unplug"]) == 0
        assert not port.exists(), "the order is carried out before it is answered"
        assert run(["twin-order", str(port_file), "plug"]) == 0
        assert port.exists()
        assert move_by_hand(control, shoulder_pan=0.3)["shoulder_pan"] == 0.3
        with pytest.raises(RuntimeError, match=r"no joint wrist\. Use shoulder_pan"):
            move_by_hand(control, wrist=0.3)
        twin.send_signal(signal.SIGTERM)
        twin.communicate(timeout=PATIENCE_S)

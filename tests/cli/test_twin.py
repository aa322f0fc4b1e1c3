"""``twin`` serves the robot's end of the wire until it is interrupted."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
import serial

from strands_actors.drivers.feetech import protocol
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

"""Test a duck on another host: the system's ssh forwards its socket, as a child of each process that needs it.
A stand-in for ssh connects to the twin."""

from __future__ import annotations

import json
import os
import signal
import socket
import stat
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import Robot
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.ssh_forward import SshForward, command
from strands_actors.testing import Twin
from tests.answers import alive, json_of, pids, state, until
from tests.trees import connected, first_safe

from .rig import act


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file in which the stand-in logs its calls. The stand-in is found as ``ssh``."""
    folder = tmp_path / "bin"
    folder.mkdir()
    program = folder / "ssh"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {Path(__file__).with_name("ssh_standin.py")} "$@"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("SSH_STANDIN_LOG", str(tmp_path / "calls"))
    return tmp_path / "calls"


@pytest.fixture
def twin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Twin]:
    with Twin("microduck", tmp_path) as process:
        monkeypatch.setenv("SSH_STANDIN_ROBOTD", process.port)
        yield process


def calls(log: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []


def test_ssh_asks_for_nothing_shares_nothing_and_takes_no_host_for_an_option() -> None:
    words = command("ssh", "me@duck", 2222, 5.0, [("/tmp/a", "/run/robotd.sock")])
    assert words[:3] == ["ssh", "-N", "-T"] and words[-2:] == ["--", "me@duck"]
    assert {"BatchMode=yes", "ExitOnForwardFailure=yes", "ControlPath=none", "ConnectTimeout=5"} <= set(words)
    assert words[words.index("-L") + 1] == "/tmp/a:/run/robotd.sock"
    assert words[words.index("-p") + 1] == "2222"
    assert "-p" not in command("ssh", "duck", 0, 5.0, [])


def test_the_messages_of_ssh_are_shown(log: Path) -> None:
    async def main() -> None:
        forward = SshForward("refused.example", 0, ["/run/robotd.sock"])
        try:
            await forward.open("/run/robotd.sock", 20.0)
        finally:
            forward.close()

    with pytest.raises(WireDown, match="Permission denied"):
        trio.run(main)


def test_a_missing_ssh_is_named() -> None:
    async def main() -> None:
        forward = SshForward("duck", 0, ["/run/robotd.sock"], program="no-such-ssh")
        try:
            await forward.open("/run/robotd.sock", 20.0)
        finally:
            forward.close()

    with pytest.raises(WireDown, match="no-such-ssh: No such file"):
        trio.run(main)


@pytest.mark.long
def test_saf_003_a_duck_behind_ssh_is_stopped_through_the_roots_ssh(twin: Twin, log: Path, run_dir: Path) -> None:
    with Robot("microduck", mode="real", port="ssh://me@duck.example") as duck:
        connected(duck)
        act(duck, twin, vx=0.2, duration=10)
        by_parent = {call["parent"]: call["pid"] for call in calls(log)}
        assert all(call["words"][-1] == "me@duck.example" for call in calls(log))
        wire, root = pids(duck)["wire"], pids(duck)["root"]
        assert {wire, root} <= set(by_parent), "wire and root each start a separate ssh"
        began_ns = time.monotonic_ns()
        os.kill(wire, signal.SIGKILL)
        first_safe(twin.log, began_ns)
        until(lambda: not alive(by_parent[wire]), "the wire's ssh ends with it")
        until(lambda: state(duck) == "disarmed", "a new wire, disarmed")
        twin.log.no_setpoint_after_safe(began_ns)
        json_of(duck.resume())
    until(lambda: not any(alive(call["pid"]) for call in calls(log)), "no ssh is left behind")


@pytest.mark.long
def test_one_frame_of_the_depth_sensor_comes_over_its_own_socket(
    twin: Twin, log: Path, run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "tof"
    frame = {"jsonrpc": "2.0", "method": "tof.frame", "params": {"distance_mm": [400 + at for at in range(64)]}}
    requested: list[Any] = []
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen()
    listener.settimeout(30.0)

    def serve() -> None:
        client, _ = listener.accept()
        with client:
            requested.append(json.loads(client.makefile().readline()))
            client.sendall(json.dumps(frame).encode() + b"\n")
            client.recv(1)

    tofd = threading.Thread(target=serve, daemon=True)
    tofd.start()
    monkeypatch.setenv("SSH_STANDIN_TOFD", str(path))
    try:
        with Robot("microduck", mode="real", port="ssh://duck.example") as duck:
            connected(duck)
            assert json_of(duck.tof())["distance_mm"] == [400.0 + at for at in range(64)]
    finally:
        listener.close()
        tofd.join(10.0)
    assert [call["method"] for call in requested] == ["tof.stream"]

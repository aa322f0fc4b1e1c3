"""The host tells systemd that it is ready and alive."""

from __future__ import annotations

import os
import socket
from pathlib import Path

from strands_actors.surfaces.host.notify import ALIVE, READY, Notifier


def test_states_arrive_in_one_datagram(run_dir: Path) -> None:
    path = run_dir / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(path))
        environment = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "6000000", "WATCHDOG_PID": str(os.getpid())}
        notifier = Notifier(environment)
        notifier.send(READY, "STATUS=two robots")
        assert systemd.recv(4096) == b"READY=1\nSTATUS=two robots"
        notifier.send(ALIVE)
        assert systemd.recv(4096) == b"WATCHDOG=1"
    assert environment == {}, "no child may speak to systemd"
    notifier.send(ALIVE)  # systemd does not listen any more


def test_an_abstract_address_is_used() -> None:
    name = f"strands-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(f"\0{name}")
        Notifier({"NOTIFY_SOCKET": f"@{name}"}).send(READY)
        assert systemd.recv(4096) == b"READY=1"


def test_without_systemd_nothing_is_sent() -> None:
    Notifier({}).send(READY)

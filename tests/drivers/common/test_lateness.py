"""Test that a twin identifies its client's process, and handles messages of a late process later."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from strands_actors.drivers.common.twin.lateness import Lateness

LATE_S = 0.25


@contextmanager
def accepted(family: socket.AddressFamily, place: object) -> Iterator[socket.socket]:
    """Yield the robot's end of a connection that this process has made."""
    with socket.socket(family) as listener, socket.socket(family) as client:
        listener.bind(place)  # type: ignore[arg-type]  # as the family wants it
        listener.listen()
        client.connect(listener.getsockname())
        ours, _ = listener.accept()
        with ours:
            yield ours


@pytest.mark.parametrize("family", [socket.AF_INET, socket.AF_UNIX])
def test_the_connections_of_one_process_are_late(family: socket.AddressFamily, tmp_path: os.PathLike[str]) -> None:
    place = ("127.0.0.1", 0) if family == socket.AF_INET else os.path.join(tmp_path, "socket")
    with accepted(family, place) as ours:
        assert Lateness(os.getpid(), LATE_S).of(ours) == LATE_S
        assert Lateness(os.getppid(), LATE_S).of(ours) == 0.0
        assert Lateness().of(ours) == 0.0


def test_the_datagrams_of_one_process_are_late() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as client:
        client.bind(("127.0.0.1", 0))
        assert Lateness(os.getpid(), LATE_S).of_address(client.getsockname()) == LATE_S
        assert Lateness(os.getppid(), LATE_S).of_address(client.getsockname()) == 0.0


def test_a_process_that_has_ended_is_not_late() -> None:
    with accepted(socket.AF_INET, ("127.0.0.1", 0)) as ours:
        assert Lateness(2**22 - 1, LATE_S).of(ours) == 0.0

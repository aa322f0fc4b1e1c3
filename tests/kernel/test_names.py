"""SAF-024: the address of a robot's host is looked up before a stop needs it."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import pytest
import trio

from strands_actors.kernel.channels import names
from strands_actors.kernel.processes.reserve import Reserve

from .kernel import real_time

FOUND = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("192.0.2.7", 0))]


@pytest.fixture
def reserve(monkeypatch: pytest.MonkeyPatch) -> Iterator[Reserve]:
    reserve = Reserve()
    monkeypatch.setattr(names, "RESERVE", reserve)
    monkeypatch.setattr(names, "_addresses", {})
    yield reserve


def look_ups(monkeypatch: pytest.MonkeyPatch, *answers: Any) -> list[str]:
    """Replace name look-ups by these answers, in order. Return the list of the hosts that are looked up."""
    hosts: list[str] = []

    async def getaddrinfo(host: str, port: int, **_: Any) -> Any:
        answer = answers[len(hosts)]
        hosts.append(host)
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(trio.socket, "getaddrinfo", getaddrinfo)
    return hosts


@real_time
async def test_saf_024_a_stop_uses_the_address_of_an_earlier_look_up(
    reserve: Reserve, monkeypatch: pytest.MonkeyPatch
) -> None:
    hosts = look_ups(monkeypatch, FOUND, RuntimeError("can't start new thread"))
    await names.look_up("arm", 0)
    with reserve.freed():
        assert await names.look_up("arm", 502) == [(*FOUND[0][:4], ("192.0.2.7", 502))]
    assert hosts == ["arm"]


@real_time
async def test_outside_a_stop_each_connection_looks_the_name_up_again(
    reserve: Reserve, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved = [(*FOUND[0][:4], ("192.0.2.8", 0))]
    look_ups(monkeypatch, FOUND, moved)
    await names.look_up("arm", 502)
    assert (await names.look_up("arm", 502))[0][4] == ("192.0.2.8", 502)


@real_time
async def test_without_a_thread_an_unknown_name_is_an_os_error_during_a_stop_only(
    reserve: Reserve, monkeypatch: pytest.MonkeyPatch
) -> None:
    look_ups(monkeypatch, RuntimeError("can't start new thread"), RuntimeError("another"))
    with pytest.raises(OSError, match="thread"):
        await names.look_up("arm", 502)
    with pytest.raises(RuntimeError, match="another"):
        await names.look_up("arm", 502)

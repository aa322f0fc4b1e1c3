"""Test calls into an SDK: each has a deadline, and constructed objects are kept."""

from __future__ import annotations

import threading
import weakref

import pytest
import trio

from strands_actors.contract.wire import ProcessSpent
from strands_actors.drivers.common.kit import sdk
from strands_actors.drivers.common.kit.sdk import SdkCalls, kept


@pytest.fixture(autouse=True)
def new_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sdk, "_kept", [])


class Interface:
    """An object that an SDK constructs."""

    def __init__(self, host: str) -> None:
        if not host:
            raise RuntimeError("no host")
        self.host = host


def test_constructed_objects_are_never_destroyed() -> None:
    async def main() -> weakref.ref[Interface]:
        return weakref.ref(await SdkCalls("sdk", (RuntimeError,)).construct("open", 5.0, Interface, "192.0.2.1"))

    assert not kept()
    assert trio.run(main)() is not None
    assert kept()


def test_a_constructor_that_fails_has_spent_the_process_and_may_have_left_half_of_it() -> None:
    calls = SdkCalls("sdk", (RuntimeError,))
    with pytest.raises(ProcessSpent, match=r"sdk: open failed \(no host\)"):
        trio.run(calls.construct, "open", 5.0, Interface, "")
    assert kept() and calls.spent
    with pytest.raises(ProcessSpent):
        trio.run(calls.call, "move", 5.0, Interface, "192.0.2.1")


def test_saf_002_a_call_that_misses_its_deadline_is_the_end_of_the_process() -> None:
    calls, release = SdkCalls("sdk", (RuntimeError,)), threading.Event()
    with pytest.raises(ProcessSpent, match="move did not return within 50 ms"):
        trio.run(calls.call, "move", 0.05, release.wait)
    release.set()
    assert "move did not return" in calls.spent

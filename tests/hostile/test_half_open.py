"""Test commands that wait on a half-open connection while a stop is confirmed on a new one (SAF-021).

The robot no longer receives the bytes of the connections that were open, but answers on new ones. The waiting bytes
may arrive at any later time, until the connection is reset. The tests run in virtual time.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable
from functools import partial
from typing import Any, NamedTuple

import pytest
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Wire, WireDown, all_safe
from strands_actors.drivers.microduck.gates import MOVES, UNTIL
from strands_actors.drivers.microduck.wire import UNANSWERED
from strands_actors.kernel.clock import NS, Clock, VirtualClock
from strands_actors.supervisors.wire.serving import Serving
from tests.drivers.common.memory_port import Permission

from .bench import Bench, Log
from .peer import HostilePeer, HostileStream
from .rigs import RIGS
from .services import Service
from .test_virtual import run

OVERDUE_S = 0.6
"""After this time a Reachy's answer is overdue."""
LATER_S = 1.0


class HalfOpen:
    """The connections that were open when this object was made. They hold what the host writes.

    Attributes:
        dropped_at: Number of messages that the robot had received when waiting bytes were dropped.
    """

    def __init__(self, peer: HostilePeer, log: Callable[[], Log]) -> None:
        self.dropped_at: list[int] = []
        self._log = log
        self._streams = list(peer._streams)
        for stream in self._streams:
            stream.write = stream.held.append  # type: ignore[assignment, method-assign]
            stream.close = partial(self._drop, stream)  # type: ignore[method-assign]

    def deliver(self) -> None:
        """Let the bytes arrive that were not dropped by a reset."""
        for stream in self._streams:
            stream.thaw()

    def _drop(self, stream: HostileStream) -> None:
        if stream.held:
            self.dropped_at.append(len(self._log()))
            stream.held.clear()
        HostileStream.close(stream)


class Row(NamedTuple):
    """A robot that gets commands on another connection than its stop.

    Attributes:
        robot: Its name in ``RIGS``.
        values: Returns a target that moves it, at this time.
        wait_s: How long the stop comes after the command.
        stop: Stops it with its wire.
    """

    robot: str
    values: Callable[[int], tuple[float, ...]]
    wait_s: float
    stop: Callable[[Wire], Any]

    def __str__(self) -> str:
        return f"{self.robot}-{self.wait_s}"


def _head(now_ns: int) -> tuple[float, ...]:
    """Return a target that turns the head of a Reachy with a move of 2 s."""
    return (0.0, 0.0, 0.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 2.0)


def _walk(now_ns: int) -> tuple[float, ...]:
    """Return a target that lets a Microduck walk for 10 s."""
    values = [0.1, *(0.0,) * UNTIL]
    values[MOVES], values[UNTIL] = 1.0, now_ns / NS + 10.0
    return tuple(values)


ROWS = (
    Row("reachy_mini", _head, 0.0, lambda wire: wire.make_safe(SafeState.HOLD)),
    Row("reachy_mini", _head, OVERDUE_S, lambda wire: wire.reach(SafeState.HOLD)),
    Row("microduck", _walk, 0.0, lambda wire: wire.reach(SafeState.STOP)),
)


@contextlib.asynccontextmanager
async def armed(bench: Bench, clock: Clock) -> AsyncIterator[tuple[Wire, Serving]]:
    """Yield a wire that accepts targets. Its background tasks end when an answer is overdue."""
    serving = Serving()
    async with bench.living(), trio.open_nursery() as nursery:
        wire: Wire = bench.driver.open_wire(clock)
        await wire.open()
        nursery.start_soon(serving.run, wire)
        await serving.ready.wait()
        await wire.arm(Permission())
        await trio.sleep(LATER_S)
        yield wire, serving
        wire.close()
        nursery.cancel_scope.cancel()


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_saf_021_a_stop_on_a_new_connection_drops_what_waits_on_the_old_one(row: Row) -> None:
    async def test(peer: HostilePeer) -> None:
        bench, clock = RIGS[row.robot].make(peer), VirtualClock()
        async with armed(bench, clock) as (wire, _):
            old = HalfOpen(peer, bench.log)
            await wire.write(row.values(clock.now_ns()), Permission())
            await trio.sleep(row.wait_s)
            entries = len(bench.log())
            reports: tuple[MotorReport, ...] = await row.stop(wire)
            assert all_safe(reports), reports
            old.deliver()
            await trio.sleep(LATER_S)
            kinds = [kind for _, kind in bench.log()]
            assert "setpoint" not in kinds[entries:]
            assert "safe" in kinds[old.dropped_at[0] :], "the robot is stopped again after the reset"

    run(test)


def test_saf_021_a_service_of_a_microduck_that_is_not_answered_is_dropped() -> None:
    """Otherwise it could be carried out at any time after a stop on another connection."""

    async def test(peer: HostilePeer) -> None:
        bench = RIGS["microduck"].make(peer)
        async with armed(bench, VirtualClock()) as (wire, serving):
            old = HalfOpen(peer, bench.log)
            with pytest.raises(WireDown, match="no answer within"):
                await wire.perform("disable", {}, Permission())
            await trio.sleep(0.0)
            old.deliver()
            await trio.sleep(LATER_S)
            assert bench.robot.body.enabled, "the request has not arrived"
            assert str(serving.failure) == UNANSWERED

    run(test)


def test_saf_020_a_reachy_that_cannot_answer_is_stopped_on_the_open_connection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A command waits for its answer, and no new connection can be opened. But the robot receives what is sent."""
    cut_off = trio.Event()
    open_stream = Service.open_stream

    async def connect(service: Service, host: str, port: int) -> Any:
        if cut_off.is_set():
            await trio.sleep_forever()
        return await open_stream(service, host, port)

    monkeypatch.setattr(Service, "open_stream", connect)

    async def test(peer: HostilePeer) -> None:
        bench, clock = RIGS["reachy_mini"].make(peer), VirtualClock()
        async with armed(bench, clock) as (wire, _), trio.open_nursery() as nursery:
            peer.begin("changed", change=lambda data: b"")
            cut_off.set()
            await wire.write(_head(clock.now_ns()), Permission())
            await trio.sleep(0.01)
            assert bench.robot.body.move is not None
            nursery.start_soon(wire.make_safe, SafeState.HOLD)
            await trio.sleep(bench.driver.bound_s)
            assert bench.robot.body.move is None
            nursery.cancel_scope.cancel()

    run(test)

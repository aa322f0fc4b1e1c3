"""Test the root's participant alone, with a twin: its messages, their order, and its reports."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.booster import protocol as p
from strands_actors.drivers.booster import rpc
from strands_actors.drivers.booster.config import BoosterConfig
from strands_actors.drivers.booster.robots import model_of
from strands_actors.drivers.booster.stop_channel import BoosterStopChannel
from strands_actors.drivers.booster.wire import BoosterWire
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.testing import WireLog
from tests.drivers.common.twin_process import TwinProcess

Reports = tuple[MotorReport, ...]


@contextmanager
def twin(directory: Path, **options: Any) -> Iterator[TwinProcess]:
    with TwinProcess(directory, "booster_t1", "booster", options=options) as served:
        yield served


def config(served: TwinProcess) -> BoosterConfig:
    return BoosterConfig(model_of("booster_t1"), served.port)


def with_channel(served: TwinProcess, act: Callable[[BoosterStopChannel], Awaitable[Reports]]) -> Reports:
    """Return the result of ``act`` on a ready channel."""

    async def main() -> Reports:
        channel = BoosterStopChannel(config(served), (), MonotonicClock())
        async with trio.open_nursery() as nursery:
            with trio.fail_after(20.0):
                await nursery.start(channel.serve)
                reports = await act(channel)
            channel.close()
            nursery.cancel_scope.cancel()
        return reports

    return trio.run(main)


def frames(served: TwinProcess) -> list[str]:
    """Return the host's messages in order: the name of an order, or ``hold`` for a LowCmd."""
    reported: list[str] = []
    for entry in WireLog(served.log_path).entries():
        if entry.sender != "host":
            continue
        if b"api_id" not in entry.data:
            p.decode_command(entry.data)
            name = "hold" if entry.kind == "safe" else "setpoint"
        else:
            name = rpc.Api(rpc.decode_request(entry.data).api).name
        if reported[-1:] != [name]:
            reported.append(name)
    return reported


def test_the_base_stands_the_arms_are_held_then_given_back(tmp_path: Path) -> None:
    with twin(tmp_path) as served:
        reports = with_channel(served, lambda channel: channel.make_safe("stop"))
        assert all(report.written and report.acknowledged and report.safe for report in reports)
        assert [report.id for report in reports] == list(range(2, 10))
        assert frames(served) == ["MOVE", "GET_MODE", "hold", "UPPER_BODY"]


def test_in_custom_mode_it_sends_no_frame(tmp_path: Path) -> None:
    """A frame has no targets for the legs, which would let go in this mode."""
    with twin(tmp_path, mode="custom") as served:

        async def twice(channel: BoosterStopChannel) -> Reports:
            await channel.make_safe("stop")
            await trio.sleep(0.5)
            # now it knows the mode, and so the owner of the arms, from the beginning
            return await channel.make_safe("stop")

        reports = with_channel(served, twice)
        assert all(report.safe for report in reports), "a Move has no effect in this mode"
        reported = frames(served)
        assert reported[0] == "MOVE" and "UPPER_BODY" in reported
        assert "hold" not in reported and "setpoint" not in reported
        kinds = [entry.kind for entry in WireLog(served.log_path).entries()]
        assert "fall" not in kinds


@pytest.mark.parametrize("mode", ["damping", "prepare"])
def test_a_zero_that_is_refused_counts_where_the_robot_cannot_walk(tmp_path: Path, mode: str) -> None:
    with twin(tmp_path, mode=mode) as served:
        reports = with_channel(served, lambda channel: channel.make_safe("stop"))
        assert all(report.safe for report in reports)
        assert "UPPER_BODY" in frames(served), "the arms are returned all the same"


def test_an_estop_s_state_is_damping(tmp_path: Path) -> None:
    with twin(tmp_path) as served:
        reports = with_channel(served, lambda channel: channel.make_safe("damp"))
        assert all(report.safe for report in reports)
        assert frames(served)[:2] == ["MOVE", "CHANGE_MODE"]
        assert "hold" not in frames(served)


def test_saf_005_a_robot_that_does_not_answer_is_not_confirmed(tmp_path: Path) -> None:
    with twin(tmp_path) as served:

        async def stop(channel: BoosterStopChannel) -> Reports:
            os.kill(served.process.pid, signal.SIGSTOP)
            try:
                began_s = time.monotonic()
                reports = await channel.make_safe("stop")
                assert time.monotonic() - began_s < 2.0, "the stop ends in time"
            finally:
                os.kill(served.process.pid, signal.SIGCONT)
            again = await channel.make_safe("stop")
            assert all(report.safe for report in again), "the stop is tried again"
            return reports

        reports = with_channel(served, stop)
        assert all(report.written and not report.safe for report in reports)
        assert {report.detail for report in reports} == {"Move(0, 0, 0): not answered"}


@pytest.mark.long
def test_without_a_robot_it_is_not_ready(tmp_path: Path) -> None:
    nobody = BoosterConfig(model_of("booster_t1"), "127.0.0.77")

    async def main() -> None:
        channel = BoosterStopChannel(nobody, (), MonotonicClock())
        assert not any(report.written for report in await channel.make_safe("stop"))
        try:
            async with trio.open_nursery() as nursery:
                await nursery.start(channel.serve)
        finally:
            channel.close()

    with pytest.RaisesGroup(WireDown, flatten_subgroups=True):
        trio.run(main)


def test_saf_020_a_wire_that_was_never_open_reaches_the_robot_all_the_same(tmp_path: Path) -> None:
    with twin(tmp_path) as served:

        async def main() -> Reports:
            with trio.fail_after(20.0):
                return await BoosterWire(config(served), MonotonicClock()).reach("stop")

        assert all(report.safe for report in trio.run(main))
        assert frames(served)[0] == "MOVE"

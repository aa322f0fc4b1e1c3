"""Test which messages the wire re-sends, for how long, and to which peers it sends nothing. The test owns the
socket and the clock."""

from __future__ import annotations

import json
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.codecs.json_rpc import Call
from strands_actors.drivers.microduck import protocol as p
from strands_actors.drivers.microduck.driver import Microduck
from strands_actors.drivers.microduck.gates import HEADS, MOVES, UNTIL
from strands_actors.drivers.microduck.twin import DuckTwin
from strands_actors.drivers.microduck.wire import MicroduckWire
from strands_actors.kernel.clock import MonotonicClock

WALKS = (0.2, 0.0, 0.1)


class Clock(MonotonicClock):
    """A clock that the test advances."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def now_ns(self) -> int:
        return round(self.now_s * 1e9)


class Allowed:
    def check(self) -> None:
        pass


class Denied:
    def check(self) -> None:
        raise PermitDenied("a stop is waiting")


class Rig:
    """A connected wire, and the messages at robotd's end of it."""

    def __init__(self, wire: MicroduckWire, clock: Clock, robotd: socket.socket) -> None:
        self.wire = wire
        self.clock = clock
        self._robotd = robotd

    def tell_state(self, t_s: float | None = None, **changed: Any) -> None:
        """Deliver a state. ``t_s`` is the robot's own time; by default it is the test's."""
        t_s = self.clock.now_s if t_s is None else t_s
        reported = {**DuckTwin("microduck").state(), "t": t_s, **changed}
        self.wire._link._take(Call(p.STATE, reported, None, True))

    def heard(self) -> list[dict[str, Any]]:
        try:
            data = self._robotd.recv(65536)
        except BlockingIOError:
            return []
        return [json.loads(line) for line in data.splitlines()]

    def say(self, data: bytes) -> None:
        with suppress(BlockingIOError):
            self._robotd.send(data)

    async def walk(self, until_s: float) -> None:
        values = [*WALKS, *(0.0,) * 14]
        values[MOVES], values[UNTIL] = 1.0, until_s
        await self.wire.write(tuple(values), Allowed())


@asynccontextmanager
async def rig(folder: Path) -> AsyncIterator[Rig]:
    path = folder / "robotd"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        clock = Clock()
        wire = MicroduckWire(Microduck("microduck", str(path), {}).config, clock)
        await wire._link.connect()
        robotd, _ = listener.accept()
        with robotd:
            robotd.setblocking(False)
            one = Rig(wire, clock, robotd)
            one.tell_state()
            try:
                yield one
            finally:
                wire.close()


def run(folder: Path, test: Callable[[Rig], Any]) -> None:
    async def main() -> None:
        async with rig(folder) as one:
            await test(one)

    trio.run(main)


def test_saf_001_a_twist_past_its_end_is_zeroed_once_by_the_wire_itself(tmp_path: Path) -> None:
    async def test(one: Rig) -> None:
        await one.walk(until_s=100.5)
        assert [call["params"] for call in one.heard()] == [p.move(*WALKS)]
        for _ in range(3):
            one.clock.now_s += 0.05
            one.tell_state()
            await one.wire.feed()
        assert [call["params"] for call in one.heard()] == [p.move(*WALKS)] * 3
        one.clock.now_s = 100.5
        one.tell_state()
        await one.wire.feed()
        await one.wire.feed()
        assert [(call["method"], call["params"]) for call in one.heard()] == [(p.MOVE, p.REST)]

    run(tmp_path, test)


def test_saf_010_nothing_is_sent_to_a_robot_with_an_old_state(tmp_path: Path) -> None:
    async def test(one: Rig) -> None:
        await one.walk(until_s=110.0)
        one.heard()
        one.clock.now_s += 0.21
        await one.wire.feed()
        with pytest.raises(PermitDenied, match="210 ms old"):
            await one.walk(until_s=110.0)
        assert one.heard() == []
        one.tell_state()
        await one.wire.feed()
        assert len(one.heard()) == 1, "the robot is sent messages again"

    run(tmp_path, test)


def test_saf_012_a_state_with_a_frozen_time_is_not_new(tmp_path: Path) -> None:
    """The loop of robotd is stuck, and its socket repeats the last state."""

    async def test(one: Rig) -> None:
        one.tell_state(12.34)
        seen = await one.wire.read()
        await one.walk(until_s=110.0)
        one.heard()
        for _ in range(30):
            one.clock.now_s += 0.02
            one.tell_state(12.34, head=[0.1, 0.0, 0.0, 0.0])  # other changes in it do not make it new
            if one.clock.now_s < 100.5:
                again = await one.wire.read()
                assert again.t_ns == seen.t_ns == max(again.stamp_ns)
            if one.clock.now_s > 100.21:
                one.heard()
                await one.wire.feed()
                with pytest.raises(PermitDenied, match="ms old"):
                    await one.walk(until_s=110.0)
                assert one.heard() == []
        one.clock.now_s += 0.02
        one.tell_state(12.34)
        with pytest.raises(WireDown, match=r"the time in robotd's states has not changed for 0\.6 s"):
            await one.wire.read()
        one.clock.now_s += 1.0
        with pytest.raises(WireDown, match=r"no state from robotd for 0\.6 s"):
            await one.wire.read()

    run(tmp_path, test)


def test_states_of_a_restarted_robotd_are_new_although_they_count_from_zero(tmp_path: Path) -> None:
    async def test(one: Rig) -> None:
        for t_s in (500.0, 0.02, 0.04):
            one.clock.now_s += 0.5
            one.tell_state(t_s)
            assert (await one.wire.read()).t_ns == one.clock.now_ns()

    run(tmp_path, test)


@pytest.mark.parametrize("before", [None, 500.0])
def test_saf_012_connecting_waits_for_two_stamps(tmp_path: Path, before: float | None) -> None:
    """One state may be the last of a stuck loop. One of an earlier connection proves nothing."""

    async def test(one: Rig) -> None:
        link = one.wire._link
        if before is not None:
            one.tell_state(before)
        link.close()
        await link.connect()
        for t_s, goes_on in ((7.0, False), (7.0, False), (7.02, True), (7.02, True)):
            one.tell_state(t_s)
            assert link.stamps.goes_on is goes_on

    run(tmp_path, test)


def test_saf_002_no_twist_is_re_sent_after_a_safe_state(tmp_path: Path) -> None:
    async def test(one: Rig) -> None:
        await one.walk(until_s=110.0)
        one.heard()
        with trio.move_on_after(0.3):  # no peer answers
            await one.wire.make_safe("zero")
        said = [call["method"] for call in one.heard()]
        assert said[0] == p.MOVE and set(said) <= {p.MOVE, p.STOP}
        one.tell_state()
        await one.wire.feed()
        assert one.heard() == []

    run(tmp_path, test)


def test_saf_001_the_permit_is_checked_before_anything_is_sent(tmp_path: Path) -> None:
    async def test(one: Rig) -> None:
        values = [*WALKS, *(0.0,) * 14]
        values[MOVES] = values[HEADS] = 1.0
        values[UNTIL] = 110.0
        with pytest.raises(PermitDenied, match="a stop is waiting"):
            await one.wire.write(tuple(values), Denied())
        await one.wire.feed()
        assert one.heard() == []

    run(tmp_path, test)


def test_a_twist_of_zero_is_not_re_sent(tmp_path: Path) -> None:
    async def test(one: Rig) -> None:
        await one.walk(until_s=110.0)
        values = [0.0] * 17
        values[MOVES], values[UNTIL] = 1.0, 110.0
        await one.wire.write(tuple(values), Allowed())
        one.heard()
        await one.wire.feed()
        assert one.heard() == []

    run(tmp_path, test)


def test_saf_005_without_a_connection_nothing_is_reported_as_written(tmp_path: Path) -> None:
    async def test(one: Rig) -> None:
        one.wire._link.close()
        assert all(not report.written for report in await one.wire.make_safe("stop"))

    run(tmp_path, test)


@pytest.mark.parametrize("how", ["make_safe", "reach"])
def test_saf_022_a_stop_is_sent_on_a_connection_with_invalid_answers(tmp_path: Path, how: str) -> None:
    """The stop is written at once, before another connection is made."""

    async def test(one: Rig) -> None:
        one.heard()
        with trio.fail_after(5.0):
            while one.wire._link.is_open:
                one.say(b"x" * 65536)
                with suppress(WireDown), trio.move_on_after(0.002):
                    await one.wire._link.hear()
        with trio.CancelScope() as stopping:
            stopping.cancel()
            await getattr(one.wire, how)("zero")
        said = one.heard()
        assert said and said[0]["params"] == p.REST

    run(tmp_path, test)

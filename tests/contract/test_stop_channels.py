"""Test each ready-made kind of stop channel on a robot in memory, in virtual time."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import ClassVar

import pytest
import trio
import trio.testing

from strands_actors.contract import (
    ConnectWhenNeeded,
    DuplicateDescriptor,
    KeptSession,
    MotorReport,
    WatchedFirmware,
    WireDown,
)
from strands_actors.kernel.clock import VirtualClock

Reports = tuple[MotorReport, ...]


class Robot:
    """A robot in memory, with the ports that its channels opened."""

    def __init__(self) -> None:
        self.ports: list[Port] = []
        self.reachable = True

    def connect(self) -> Port:
        if not self.reachable:
            raise WireDown("nobody there")
        self.ports.append(Port())
        return self.ports[-1]


class Port:
    def __init__(self, dead: bool = False) -> None:
        self.dead = dead
        self.closed = False
        self.written: list[str] = []
        self.looks = 0
        self.stands_after = 3

    def write(self, what: str) -> None:
        if self.dead or self.closed:
            raise WireDown("the port is dead")
        self.written.append(what)

    def look(self) -> Reports:
        if self.dead:
            raise WireDown("lost while it was watched")
        self.looks += 1
        stands = self.looks >= self.stands_after
        return (MotorReport("a", 1, bool(self.written), stands, stands, "" if stands else "it moves"),)

    def close(self) -> None:
        self.closed = True


def safe() -> Reports:
    return (MotorReport("a", 1, True, True, True),)


def failed(reason: str, port: Port | None = None) -> Reports:
    return (MotorReport("a", 1, bool(port and port.written), False, False, reason),)


def run(test: Callable[[], Awaitable[None]]) -> None:
    async def limited() -> None:
        with trio.fail_after(60):
            await test()

    trio.run(limited, clock=trio.testing.MockClock(autojump_threshold=0))


# -- a duplicate of the descriptor


class Duplicate(DuplicateDescriptor[Robot, Port]):
    adopted: Port

    def adopt(self, descriptor: int) -> Port:
        self.adopted = Port(dead=descriptor < 0)
        return self.adopted

    async def open_port(self) -> Port:
        return self.config.connect()

    async def make_safe_on(self, port: Port, safe_state: str) -> Reports:
        port.write(safe_state)
        return safe()

    def failed(self, reason: str) -> Reports:
        return failed(reason)


def test_the_wires_own_descriptor_is_used_first_and_again() -> None:
    async def test() -> None:
        robot = Robot()
        channel = Duplicate(robot, (7,), VirtualClock())
        assert await channel.make_safe("limp") == await channel.make_safe("limp") == safe()
        assert channel.adopted.written == ["limp", "limp"] and not robot.ports
        channel.close()
        assert channel.adopted.closed

    run(test)


def test_saf_020_a_dead_descriptor_is_closed_and_the_port_is_opened_again() -> None:
    async def test() -> None:
        robot = Robot()
        channel = Duplicate(robot, (-1,), VirtualClock())
        assert await channel.make_safe("limp") == safe()
        assert channel.adopted.closed, "an open descriptor makes the adapter return under another name"
        robot.ports[0].dead = True
        assert await channel.make_safe("limp") == safe()
        assert robot.ports[0].closed and robot.ports[1].written == ["limp"]
        robot.ports[1].dead, robot.reachable = True, False
        assert await channel.make_safe("limp") == failed("nobody there")
        robot.reachable = True
        assert await channel.make_safe("limp") == safe(), "the next attempt makes a new connection"

    run(test)


# -- a connection made when needed


class Connecting(ConnectWhenNeeded[Robot, Port]):
    async def connect(self) -> Port:
        return self.config.connect()

    async def make_safe_by(self, port: Port, safe_state: str) -> Reports:
        port.write(safe_state)
        if safe_state == "lost":
            raise WireDown("lost after it was written")
        return safe()

    def failed(self, reason: str, port: Port | None = None) -> Reports:
        return failed(reason, port)


def test_each_stop_makes_a_connection_and_always_closes_it() -> None:
    async def test() -> None:
        robot = Robot()
        channel = Connecting(robot, (), VirtualClock())
        assert await channel.make_safe("stop") == safe()
        (report,) = await channel.make_safe("lost")
        assert (report.written, report.safe, report.detail) == (True, False, "lost after it was written")
        assert [port.closed for port in robot.ports] == [True, True]
        robot.reachable = False
        assert await channel.make_safe("stop") == failed("nobody there")

    run(test)


# -- firmware that stops by itself


class Watching(WatchedFirmware[Robot, Port]):
    CONFIRM_S: ClassVar[float] = 0.5
    LOOK_S: ClassVar[float] = 0.1

    async def connect(self) -> Port:
        return self.config.connect()

    def order(self, watch: Port, safe_state: str) -> None:
        watch.write(safe_state)

    def failed(self, reason: str, port: Port | None = None) -> Reports:
        return failed(reason, port)


def test_saf_005_firmware_is_watched_until_it_has_stopped_or_the_time_is_over() -> None:
    async def test() -> None:
        robot = Robot()
        channel = Watching(robot, (), VirtualClock())
        (report,) = await channel.make_safe("stop")
        assert report.safe and report.written and robot.ports[0].looks == 3
        connect = robot.connect

        def never_stands() -> Port:
            port = connect()
            port.stands_after = 1000
            return port

        robot.connect = never_stands  # type: ignore[method-assign]
        began_s = trio.current_time()
        (report,) = await channel.make_safe("stop")
        assert (report.safe, report.detail) == (False, "it moves")
        assert trio.current_time() - began_s == pytest.approx(0.5)
        assert all(port.closed for port in robot.ports)

    run(test)


# -- a session kept up


class Kept(KeptSession[Robot, Port]):
    other_way = False

    async def connect(self) -> Port:
        await trio.sleep(0.01)
        return self.config.connect()

    async def keep_up(self, session: Port) -> None:
        while True:
            await trio.sleep(0.5)
            session.write("keep")

    async def make_safe_by(self, session: Port | None, safe_state: str) -> Reports:
        if session is None:
            return failed("no session")
        session.write(safe_state)
        return safe()

    @property
    def has_other_way(self) -> bool:
        return self.other_way


def test_a_session_is_open_before_it_is_needed_and_replaced_when_it_is_lost() -> None:
    async def test() -> None:
        robot = Robot()
        channel = Kept(robot, (), VirtualClock())
        async with trio.open_nursery() as nursery:
            await nursery.start(channel.serve)
            assert len(robot.ports) == 1
            robot.ports[0].dead = True
            robot.reachable = False
            await trio.sleep(2.0)
            assert not robot.ports[0].closed, "a lost session is kept until a new one is open"
            robot.reachable = True
            await trio.sleep(1.0)
            assert robot.ports[0].closed and len(robot.ports) == 2
            nursery.cancel_scope.cancel()
        channel.close()
        assert robot.ports[1].closed

    run(test)


def test_saf_002_a_session_has_no_other_user_once_it_stops_the_robot() -> None:
    async def test() -> None:
        robot = Robot()
        channel = Kept(robot, (), VirtualClock())
        async with trio.open_nursery() as nursery:
            await nursery.start(channel.serve)
            assert await channel.make_safe("stop") == safe()
            await trio.sleep(3.0)
        assert robot.ports[0].written == ["stop"], "no keepalive follows the stop"

    run(test)


def test_a_stop_while_the_session_is_being_opened_does_not_wait_for_it() -> None:
    async def test() -> None:
        robot = Robot()
        channel = Kept(robot, (), VirtualClock())
        async with trio.open_nursery() as nursery:
            nursery.start_soon(nursery.start, channel.serve)
            await trio.sleep(0.005)
            assert await channel.make_safe("stop") == failed("no session")
            await trio.sleep(1.0)
        assert not robot.ports

    run(test)


@pytest.mark.parametrize("other_way", [False, True])
def test_a_link_counts_as_up_without_a_session_only_if_another_way_exists(other_way: bool) -> None:
    async def test() -> None:
        robot = Robot()
        robot.reachable = False
        channel = Kept(robot, (), VirtualClock())
        channel.other_way = other_way
        if other_way:
            await channel.serve()
        else:
            with pytest.raises(WireDown, match="nobody there"):
                await channel.serve()

    run(test)

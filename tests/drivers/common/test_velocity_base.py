"""Test how a base behind a service is stopped, and its ports: in virtual time, with services in memory."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable

import msgspec
import pytest
import trio
import trio.testing

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.http_messages import Request, ServerEnd, encode_response
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.velocity_base import MotionReport, Outcome, stop_base
from strands_actors.drivers.common.ports.http_port import HttpPort
from strands_actors.testing import run_virtual

ANSWER_S = 0.002


class Service:
    """A base that reports its speed every 0.1 s, and stands ``stands_s`` after the first zero."""

    def __init__(self, stands_s: float = 0.2) -> None:
        self.stands_s = stands_s
        self.heard: list[tuple[float, str]] = []  # time and target of each request
        self.opened = 0
        self.down = self.mute = False
        self.stamps = True
        self.zero_s = math.inf
        # seconds since the first zero: a late command moves the base
        self.moves_s: tuple[float, float] | None = None

    async def open_stream(self, host: str, port: int) -> Stream:
        await trio.lowlevel.checkpoint()
        if self.down:
            raise WireDown(f"{host}:{port}: cannot connect")
        self.opened += 1
        return Stream(self)

    def answer(self, request: Request) -> bytes:
        now_s = trio.current_time()
        self.heard.append((now_s, request.target))
        if request.target == "/stop":
            self.zero_s = min(self.zero_s, now_s)
            return encode_response(200, b"{}")
        stamp_s = math.floor(now_s * 10) / 10 if self.stamps else 1.0
        speed = 0.0 if stamp_s >= self.zero_s + self.stands_s else 0.5
        if self.moves_s is not None and self.moves_s[0] <= stamp_s - self.zero_s < self.moves_s[1]:
            speed = 0.5
        return encode_response(200, msgspec.json.encode([stamp_s, speed]))


class Stream:
    def __init__(self, service: Service) -> None:
        self._service = service
        self._end = ServerEnd()
        self._coming: deque[tuple[float, bytes]] = deque()
        self._news = trio.Event()
        self._closed = False

    def write(self, data: bytes) -> None:
        if self._closed or self._service.down:
            raise WireDown("the connection is gone")
        for request in self._end.feed(data):
            answer = self._service.answer(request)
            if not self._service.mute:
                self._coming.append((trio.current_time() + ANSWER_S, answer))
        self._news.set()

    async def read(self) -> bytes:
        while not self._coming:
            self._news = trio.Event()
            await self._news.wait()
        await trio.sleep_until(self._coming[0][0])
        return b"".join(data for _, data in [self._coming.popleft() for _ in range(len(self._coming))])

    def close(self) -> None:
        self._closed = True

    def close_in_order(self) -> None:
        self._closed = True


class Zero:
    target = "/stop"
    body = b"{}"
    state_target = "/state"

    def __init__(self, steady_s: float = 0.0) -> None:
        self.steady_s = steady_s

    def read_motion(self, body: bytes) -> MotionReport:
        try:
            return MotionReport(*msgspec.json.decode(body, type=tuple[float, float]))
        except msgspec.DecodeError as error:
            raise MalformedFrame(str(error)) from None


def stopping(
    service: Service,
    within_s: float = 1.5,
    pending: Callable[[], bool] = lambda: False,
    steady_s: float = 0.0,
) -> tuple[Outcome, float]:
    """Return the outcome of the stop, and its duration in seconds."""
    found: list[tuple[Outcome, float]] = []

    async def run() -> None:
        await trio.sleep(1.03)
        began_s = trio.current_time()
        port = HttpPort("192.0.2.1", 80, service.open_stream)
        outcome = await stop_base(port, Zero(steady_s), within_s, pending)
        found.append((outcome, trio.current_time() - began_s))

    run_virtual(run)
    return found[0]


def test_saf_005_zero_is_repeated_until_a_newer_report_shows_speed_0() -> None:
    service = Service()
    outcome, took_s = stopping(service)
    assert outcome == Outcome(True, True, "") and 0.2 < took_s < 0.4
    assert sum(target == "/stop" for _, target in service.heard) >= 4


def test_saf_005_a_report_from_before_the_zero_proves_nothing() -> None:
    service = Service(stands_s=-10.0)  # every report shows speed 0
    service.stamps = False  # each has the same stamp as the previous one
    outcome, took_s = stopping(service)
    assert outcome == Outcome(
        True, True, "not confirmed: it has reported nothing since"
    ) and took_s == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("moves_s", "longer_s"),
    [(None, 0.0), ((0.3, 0.5), 0.5), ((0.6, 0.7), 0.7)],
)
def test_saf_010_a_base_stands_when_it_does_so_without_a_break(
    moves_s: tuple[float, float] | None, longer_s: float
) -> None:
    """A command that left before the stop may arrive after the first report of speed 0."""
    service = Service(stands_s=-10.0)
    service.moves_s = moves_s
    outcome, took_s = stopping(service, 2.0, steady_s=0.8)
    assert outcome == Outcome(True, True, "") and 0.8 + longer_s < took_s < 1.1 + longer_s
    zeros_s = [t_s for t_s, target in service.heard if target == "/stop"]
    assert all(later - sooner < 0.1 for sooner, later in itertools.pairwise(zeros_s)), (
        "zero is repeated until the base stands"
    )
    outcome, _ = stopping(service, 0.7, steady_s=0.8)
    assert outcome.acknowledged and "not confirmed: it must report speed 0 for" in outcome.detail


def test_saf_010_nothing_is_confirmed_while_the_answer_to_a_command_is_pending() -> None:
    service = Service(stands_s=-10.0)
    outcome, _ = stopping(service, pending=lambda: trio.current_time() < 10)
    assert "an earlier command has not been answered" in outcome.detail
    answered, took_s = stopping(Service(stands_s=-10.0), pending=lambda: trio.current_time() < 1.6)
    assert answered.detail == "" and took_s > 1.6 - 1.03


def test_saf_005_a_base_that_moves_on_is_not_reported_as_stopped() -> None:
    outcome, _ = stopping(Service(stands_s=100.0))
    assert outcome == Outcome(True, True, "not confirmed: it reports speed 0.5")


def test_a_silent_service_gets_the_stop_again_on_a_new_connection() -> None:
    service = Service()
    service.mute = True
    outcome, _ = stopping(service)
    assert outcome.written and not outcome.acknowledged and "no answer within 200 ms" in outcome.detail
    assert service.opened > 4


def test_a_service_that_is_not_there_is_a_report() -> None:
    service = Service()
    service.down = True
    outcome, _ = stopping(service)
    assert not outcome.written and "cannot connect" in outcome.detail


def test_saf_006_the_first_zero_leaves_before_the_first_wait() -> None:
    service = Service()

    async def run() -> None:
        port = HttpPort("192.0.2.1", 80, service.open_stream)
        async with trio.open_nursery() as nursery:
            await nursery.start(port.serve)
            await trio.sleep(3.0)
            began_s = trio.current_time()
            await stop_base(port, Zero(), 1.5)
            assert service.heard[0] == (began_s, "/stop") and service.opened == 1
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_responses_that_arrive_together_are_separated() -> None:
    async def run() -> None:
        port = HttpPort("192.0.2.1", 80, Service().open_stream)
        await port.open()
        stop, state = port.send("POST", "/stop", b"{}"), port.send("GET", "/state")
        assert (await port.answer(stop, 1.0)).body == b"{}"
        assert (await port.answer(state, 1.0)).body.startswith(b"[")
        assert not port.waits

    run_virtual(run)


def test_a_connection_that_was_idle_takes_no_command() -> None:
    """The service may close it at the same time."""

    async def run() -> None:
        service = Service()
        port = HttpPort("h", 1, service.open_stream)
        for pause_s, opened in ((0.0, 1), (1.9, 1), (2.1, 2), (0.1, 2)):
            await trio.sleep(pause_s)
            await port.ready()
            await port.answer(port.send("POST", "/stop"), 1.0)
            assert service.opened == opened
        service.mute = True
        port.send("POST", "/stop")
        await trio.sleep(2.1)
        await port.ready()
        assert service.opened == 2, "a connection with a pending answer is kept, and one new connection is opened"

    run_virtual(run)


def test_a_late_connect_does_not_drop_the_connection_of_another_task() -> None:
    async def run() -> None:
        service = Service()
        took_s = iter((0.3, 0.1))

        async def open_stream(host: str, port: int) -> Stream:
            await trio.sleep(next(took_s))
            return await service.open_stream(host, port)

        port = HttpPort("h", 1, open_stream)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(port.open)
            await trio.testing.wait_all_tasks_blocked()
            await port.open()
            number = port.send("POST", "/stop")
            await trio.sleep(0.3)
            assert (await port.answer(number, 1.0)).status == 200

    run_virtual(run)

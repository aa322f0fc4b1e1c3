"""Test whether the mode of a T1 is known, and which program controls its arms.

The tests cover the requests, the answers that count, and the return of the arms. Where there is a twin, its log
decides.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import pytest
import trio

from strands_actors.drivers.booster import protocol as p
from strands_actors.drivers.booster import rpc
from strands_actors.drivers.booster.config import BoosterConfig
from strands_actors.drivers.booster.link import Link
from strands_actors.drivers.booster.robots import model_of
from strands_actors.drivers.booster.rpc import Api, Mode, Response
from strands_actors.drivers.booster.stopping import _StopProcedure
from strands_actors.drivers.booster.wire import BoosterSession, BoosterWire
from strands_actors.drivers.common.rtps import CDR
from strands_actors.kernel.clock import NS, MonotonicClock
from strands_actors.kernel.messages import Refused
from strands_actors.testing import WireLog
from tests.answers import PATIENCE_S, state, status, until
from tests.drivers.common.memory_port import Permission
from tests.drivers.common.twin_process import TwinProcess
from tests.trees import first_safe

from .test_stop_channel import config, twin
from .test_tree import T1, steadily, t1

NOBODY = BoosterConfig(model_of("booster_t1"), "127.0.0.78")
TICK_NS = NS // 100
WALKING, SOCCER, CUSTOM = (rpc.change_mode(mode) for mode in (Mode.WALKING, Mode.SOCCER, Mode.CUSTOM))
"""Requests that also have the form of an answer to GetMode."""


@pytest.fixture
def robot(tmp_path: Path, run_dir: Path) -> Iterator[T1]:
    with t1(tmp_path) as standing:
        yield standing


class Service:
    """The robot's service, for a link without a peer."""

    def __init__(self, link: Link) -> None:
        self.asked: list[tuple[Api, str]] = []
        self._heard: list[Callable[[Response], None]] = []
        link.calls.ask = self._ask  # type: ignore[method-assign]

    def _ask(self, api: Api, body: str, heard: Callable[[Response], None], stop: bool = False) -> bool:
        self.asked.append((api, body))
        self._heard.append(heard)
        return True

    def answer(self, api: Api, status: int = rpc.OK, body: str = "", question: int = -1) -> None:
        """Answer a request of this kind. ``question`` is its index; the default is the last."""
        at = [at for at, (asked, _) in enumerate(self.asked) if asked == api][question]
        self._heard[at](Response("", status, body))

    def count(self, api: Api) -> int:
        return sum(asked == api for asked, _ in self.asked)


@pytest.fixture
def session() -> Iterator[BoosterSession]:
    """Return the session of a robot that reported its mode at the time 0 and handed over its arms."""
    session = BoosterSession(NOBODY, MonotonicClock())
    session.note_mode(Mode.WALKING, 0)
    session.handover_mode = Mode.WALKING
    yield session
    session.link.close()


# -- answers that count


def test_saf_012_a_mode_that_is_no_longer_reported_takes_the_arms_away(session: BoosterSession) -> None:
    service = Service(session.link)
    session.poll(round(0.95 * NS))
    assert session.mode is Mode.WALKING and session.has_arms
    session.poll(round(1.05 * NS))
    assert session.mode is None and not session.has_arms
    assert "mode" not in session.observation().sensors
    assert (Api.UPPER_BODY, rpc.upper_body(False)) in service.asked, (
        "the arms are returned, in case the robot did not have them"
    )


@pytest.mark.parametrize(("status", "body"), [(500, ""), (-1, WALKING), (rpc.OK, "?"), (rpc.OK, "{}")])
def test_saf_012_an_answer_without_a_mode_makes_the_mode_unknown(
    session: BoosterSession, status: int, body: str
) -> None:
    service = Service(session.link)
    session.poll(NS // 2)
    service.answer(Api.GET_MODE, status, body)
    assert session.mode is None and not session.has_arms
    session.poll(NS)
    service.answer(Api.GET_MODE, rpc.OK, WALKING)
    assert session.mode is Mode.WALKING and not session.has_arms, "the wire must request the arms again"


def test_saf_012_a_mode_is_as_old_as_the_question_for_it(session: BoosterSession) -> None:
    """An answer may have been under way for long. An answer to an earlier request proves nothing new."""
    service = Service(session.link)
    session.poll(round(0.3 * NS))
    session.poll(round(0.6 * NS))
    service.answer(Api.GET_MODE, rpc.OK, SOCCER)
    service.answer(Api.GET_MODE, rpc.OK, WALKING, question=0)
    assert session.observation().sensors["mode"] == (float(Mode.SOCCER), 0.6)


@pytest.mark.parametrize(
    ("has_arms", "answered", "times"),
    [(True, rpc.OK, 17), (False, rpc.OK, 5), (True, None, 5), (True, rpc.TOO_FREQUENT, 5)],
)
def test_the_mode_is_requested_more_often_while_we_control_the_arms(
    session: BoosterSession, has_arms: bool, answered: int | None, times: int
) -> None:
    """This depends on the answers: a robot that is silent, or complains of too many requests, gets fewer."""
    service = Service(session.link)
    session.handover_mode = Mode.WALKING if has_arms else None
    for at in range(1, 101):
        before = service.count(Api.GET_MODE)
        session.poll(at * TICK_NS)
        if answered is not None and service.count(Api.GET_MODE) > before:
            service.answer(Api.GET_MODE, answered, WALKING)
    assert service.count(Api.GET_MODE) == times
    assert session.mode is Mode.WALKING, "the mode is not yet old"


def test_saf_012_a_hold_ends_when_the_mode_becomes_custom() -> None:
    """The frames of a hold are commands, too. In custom mode they would make the legs let go."""
    link = Link(NOBODY, MonotonicClock())
    service, held = Service(link), []
    link.send_hold = lambda q: bool(held.append(q)) or True  # type: ignore[method-assign, func-returns-value]
    count = len(link.model.motors)
    turning = p.State(
        (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, (0.0,) * count, (1.0,) * count, (0.0,) * count, (30,) * count
    )
    began_ns = time.monotonic_ns()
    way = _StopProcedure(link, "hold", True)
    modes = iter([WALKING, CUSTOM])
    for at in range(100):
        now_ns = began_ns + at * NS // 500
        link._on_state(memoryview(CDR + p.encode_state(turning)), b"", now_ns)
        before = service.count(Api.GET_MODE)
        way.step(now_ns)
        service.answer(Api.MOVE)
        if service.count(Api.GET_MODE) > before and (mode := next(modes, None)):
            service.answer(Api.GET_MODE, rpc.OK, mode)
            until_then = len(held)
    link.close()
    assert next(modes, None) is None, "the mode was requested again"
    assert 0 < until_then == len(held), "no hold frame is sent after that answer"


# -- the consequences


def test_saf_012_a_robot_that_answers_with_errors_is_stopped(robot: T1) -> None:
    with robot.commanded():
        began_ns = time.monotonic_ns()
        robot.twin.command("answer GET_MODE 500")
        safe = first_safe(robot.log, began_ns, "stop")
        until(lambda: state(robot.robot) == "disarmed", "it is disarmed")
    robot.log.no_setpoint_after_safe(safe.t_ns)
    assert "does not report the mode" in status(robot.robot)["cause"]
    assert robot.events("upper_body") == ["host", "back"]
    assert robot.robot.resume()["status"] == "error"
    robot.twin.command("answer GET_MODE -")
    robot.enable()


def test_saf_012_a_robot_that_answers_everything_but_its_mode_is_stopped(robot: T1) -> None:
    """The link does not count as lost in this case."""
    robot.enable()
    robot.elbow(0.1)
    began_ns = time.monotonic_ns()
    robot.twin.command("answer GET_MODE nothing")
    over = threading.Event()
    asker = steadily(lambda: robot.robot.rotate_head(), over)
    try:
        until(lambda: state(robot.robot) == "disarmed", "it is disarmed")
    finally:
        over.set()
        asker.join()
    assert "the mode" in status(robot.robot)["cause"]
    robot.log.no_setpoint_after_safe(first_safe(robot.log, began_ns, "stop").t_ns)
    assert robot.events("upper_body") == ["host", "back"]


def test_saf_002_nothing_is_sent_to_the_arms_after_a_report_of_another_mode(robot: T1) -> None:
    """Frames that leave between the change and the answer cannot be called back."""
    robot.enable()
    robot.elbow(0.1)
    began_ns = time.monotonic_ns()
    until(lambda: len(robot.commands(began_ns)) > 60, "it is commanded, and again")
    asked, told = len(robot.requests(Api.GET_MODE, began_ns)), len(robot.commands(began_ns))
    robot.twin.command("mode custom")
    until(lambda: state(robot.robot) == "disarmed", "it is stopped")
    changed_ns = next(
        entry.t_ns
        for entry in robot.log.entries()
        if entry.sender == "robot" and (entry.kind, entry.data) == ("mode", b"custom")
    )
    question = next(entry for entry, _ in robot.requests(Api.GET_MODE, changed_ns))
    assert len(robot.commands(question.t_ns)) <= 3, "only commands that were under way are sent"
    assert asked and told / asked < 12, "the mode is requested once every few commands"


# -- the return of the arms


def with_wire(served: TwinProcess, act: Callable[[BoosterWire], Awaitable[None]]) -> None:
    """Run ``act`` on an open and armed wire that is read all the time."""

    async def read(wire: BoosterWire) -> None:
        while True:
            await wire.read()
            await trio.sleep(0.01)

    async def main() -> None:
        wire = BoosterWire(config(served), MonotonicClock())
        with trio.fail_after(PATIENCE_S):
            await wire.open()
            async with trio.open_nursery() as nursery:
                await nursery.start(wire.serve)
                await wire.arm(Permission())
                nursery.start_soon(read, wire)
                await act(wire)
                nursery.cancel_scope.cancel()
        wire.close()

    trio.run(main)


async def whose(served: TwinProcess, *wanted: str) -> None:
    """Wait until the twin's log names this owner of the upper body."""

    def told() -> tuple[str, ...]:
        entries = WireLog(served.log_path).entries()
        return tuple(entry.data.decode() for entry in entries if entry.kind == "upper_body")

    while told() != wanted:  # noqa: ASYNC110  # of another process
        await trio.sleep(0.02)


async def takes(wire: BoosterWire) -> None:
    await wire.perform("enable_upper_body", {}, Permission())


@pytest.mark.parametrize("safe_state", ["hold", "stop"])
def test_saf_009_a_hand_over_that_a_hold_cuts_short_is_taken_back(tmp_path: Path, safe_state: str) -> None:
    """Like the transport, cancel the service, then make the robot safe."""
    with twin(tmp_path) as served:

        async def cut(wire: BoosterWire) -> None:
            served.command("answer UPPER_BODY nothing")
            await trio.sleep(0.1)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(takes, wire)
                await whose(served, "host")  # the request has not been answered yet
                nursery.cancel_scope.cancel()
            await wire.make_safe(safe_state)
            served.command("answer UPPER_BODY -")
            await whose(served, "host", "back")
            assert (await wire.read()).sensors["upper_body"] == (0.0,)

        with_wire(served, cut)


@pytest.mark.parametrize("service", ["enable_upper_body", "disable_upper_body"])
def test_saf_010_an_unanswered_hand_over_is_taken_back_until_it_is_answered(tmp_path: Path, service: str) -> None:
    with twin(tmp_path) as served:

        async def ask(wire: BoosterWire) -> None:
            await takes(wire)
            await whose(served, "host")
            served.command("answer UPPER_BODY 500")
            await trio.sleep(0.1)
            answer = await wire.perform(service, {}, Permission())
            assert isinstance(answer, Refused) and answer.code == "status"
            assert (await wire.read()).sensors["upper_body"] == (0.0,)
            served.command("answer UPPER_BODY -")
            await whose(served, "host", "back")

        with_wire(served, ask)


def test_arms_without_an_owner_after_a_refused_mode_change_are_returned(tmp_path: Path) -> None:
    with twin(tmp_path) as served:

        async def change(wire: BoosterWire) -> None:
            await takes(wire)
            served.command("answer CHANGE_MODE 502")
            await trio.sleep(0.1)
            answer = await wire.perform("change_mode", {"mode": "prepare"}, Permission())
            assert isinstance(answer, Refused) and answer.code == "status"
            await whose(served, "host", "back")

        with_wire(served, change)


def test_a_repeated_hand_over_is_not_taken_back(tmp_path: Path) -> None:
    with twin(tmp_path) as served:

        async def again(wire: BoosterWire) -> None:
            served.command("answer UPPER_BODY 500")
            await trio.sleep(0.1)
            calls = wire.session.link.calls
            ask = calls.ask
            calls.ask = lambda api, body, heard, stop=False: (  # type: ignore[method-assign]
                False if body == rpc.upper_body(False) else ask(api, body, heard, stop)
            )  # the request to return the arms is lost
            await takes(wire)
            served.command("answer UPPER_BODY -")
            await trio.sleep(0.1)
            await takes(wire)
            await whose(served, "host")
            calls.ask = ask  # type: ignore[method-assign]
            await trio.sleep(0.5)
            await whose(served, "host")
            assert (await wire.read()).sensors["upper_body"] == (1.0,)

        with_wire(served, again)

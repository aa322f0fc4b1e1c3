"""Test how Reachy is brought to a safe state at any of its addresses, on twins in this process. The twins'
robots decide."""

from __future__ import annotations

import contextlib
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import count
from typing import Any

import msgspec
import pytest
import trio

from strands_actors.contract.wire import Permit, PermitDenied, WireDown
from strands_actors.drivers.common.codecs.http_messages import Request, Response
from strands_actors.drivers.common.ports.http_port import HttpPort
from strands_actors.drivers.common.twin import Fault, TcpServer, WireLog
from strands_actors.drivers.common.twin.http import Answer
from strands_actors.drivers.common.twin.websocket import WebSocketClient
from strands_actors.drivers.reachy import protocol as p
from strands_actors.drivers.reachy import services
from strands_actors.drivers.reachy.body import Move
from strands_actors.drivers.reachy.config import ReachyConfig
from strands_actors.drivers.reachy.driver import Reachy
from strands_actors.drivers.reachy.stop import STOP_S, ReachyStopChannel, Stopper, frames
from strands_actors.drivers.reachy.twin import ReachyTwin, serve_twin
from strands_actors.drivers.reachy.wire import ReachyWire
from strands_actors.kernel.clock import MonotonicClock

FAR = (0.0,) * 7 + (120.0, 120.0)
NOWHERE = "127.0.0.1:9"
NUMBERS = count()


@asynccontextmanager
async def daemon() -> AsyncIterator[tuple[ReachyTwin, TcpServer]]:
    """Yield a twin that plays a long move."""
    twin = ReachyTwin("reachy_mini")
    server = serve_twin(twin, WireLog(None))
    async with trio.open_nursery() as nursery:
        server.plug()
        nursery.start_soon(server.serve)
        twin.body.play(Move(f"b9cbfc2f-79b0-4181-bce4-{next(NUMBERS):012}", [(FAR, 9.0)]))
        with trio.fail_after(20):
            yield twin, server
        nursery.cancel_scope.cancel()
    server.close()


def config(*places: str) -> ReachyConfig:
    driver = Reachy("reachy_mini", "", {})
    found: ReachyConfig = msgspec.structs.replace(driver.config, places=places)
    return found


def channel(*places: str) -> ReachyStopChannel:
    return ReachyStopChannel(config(*places), (), MonotonicClock())


class Free:
    """A permit that denies after this number of checks."""

    def __init__(self, checks: int = 1000) -> None:
        self.left = checks

    def check(self) -> None:
        if self.left <= 0:
            raise PermitDenied("denied")
        self.left -= 1


@pytest.mark.parametrize("safe_state", ["hold", "limp"])
def test_saf_005_the_channel_finds_the_daemon_that_was_searched_for(safe_state: str) -> None:
    async def main() -> None:
        async with daemon() as (twin, server):
            twin.tracking = True
            reports = await channel(NOWHERE, server.address).make_safe(safe_state)
            assert len(reports) == 9 and all(one.written and one.acknowledged and one.safe for one in reports)
            assert twin.body.move is None and not twin.tracking
            assert twin.body.mode == ("disabled" if safe_state == "limp" else "enabled")

    trio.run(main)


@pytest.mark.parametrize("safe_state", ["hold", "limp"])
def test_saf_005_each_place_is_stopped_and_one_that_is_silent_is_named(safe_state: str) -> None:
    """The silent address may be the robot's, and the other one another robot's."""

    async def main() -> None:
        async with daemon() as (one, first), daemon() as (two, second):
            reports = await channel(first.address, second.address).make_safe(safe_state)
            assert all(report.safe for report in reports)
            assert one.body.move is None and two.body.move is None
            two.body.play(Move("b9cbfc2f-79b0-4181-bce4-8ce04b277b90", [(FAR, 9.0)]))
            second.freeze(3.0)
            reports = await channel(first.address, second.address).make_safe(safe_state)
            assert all(report.written and not report.safe for report in reports)
            assert second.address in reports[0].detail

    trio.run(main)


def test_saf_005_the_channel_gets_the_address_at_which_the_wire_found_the_daemon() -> None:
    """Another robot's daemon now runs at an address that is tried earlier."""

    async def main() -> None:
        async with daemon() as (other, first), daemon() as (twin, second):
            places = config(first.address, second.address)
            wire = ReachyWire(config(NOWHERE, second.address), MonotonicClock())
            assert list(wire.handover()) == []
            await wire.open()
            (reported,) = wire.handover()
            for path in [ReachyStopChannel(places, [os.dup(reported)], MonotonicClock()) for _ in range(2)]:
                twin.body.play(Move("b9cbfc2f-79b0-4181-bce4-8ce04b277b90", [(FAR, 9.0)]))
                assert all(report.safe for report in await path.make_safe("hold"))
                assert twin.body.move is None and other.body.move is not None
            wire.close()
            assert list(wire.handover()) == []

    trio.run(main)


def test_saf_005_no_daemon_and_an_invalid_address() -> None:
    async def main() -> None:
        for place, why in ((NOWHERE, "cannot connect"), ("http://a/b", "https is not supported")):
            reports = await channel(place).make_safe("hold")
            assert not any(one.written or one.safe for one in reports) and why in reports[0].detail

    trio.run(main)


def test_saf_005_torque_that_stays_on_is_no_limp_robot() -> None:
    async def main() -> None:
        async with daemon() as (twin, server):
            twin.body.set_mode = lambda mode: None  # type: ignore[method-assign]
            reports = await channel(server.address).make_safe("limp")
            assert all(one.written and not one.safe for one in reports)
            assert reports[0].detail == "not confirmed: the motors are enabled"

    trio.run(main)


@pytest.mark.parametrize("heard", ["by nobody", "by the wire"])
@pytest.mark.parametrize("safe_state", ["hold", "limp"])
def test_saf_005_no_stop_is_confirmed_before_the_daemon_has_read_it(
    monkeypatch: pytest.MonkeyPatch, safe_state: str, heard: str
) -> None:
    """The daemon sends and reads nothing on its WebSocket, but answers over HTTP. No list has the move."""

    async def only_tell(twin: ReachyTwin, client: WebSocketClient) -> None:
        await twin._stream(client, twin._sdk_frames)

    monkeypatch.setattr(ReachyTwin, "_receive_sdk", only_tell)

    async def main() -> None:
        async with daemon() as (twin, server):
            twin.body.end_move()
            twin.tracking = True
            twin.body.play(Move("b9cbfc2f-79b0-4181-bce4-8ce04b277b91", [(FAR, 9.0)], listed=False))
            if heard == "by the wire":
                async with wired(server.address) as wire:
                    reports = await wire.make_safe(safe_state)
            else:
                reports = await channel(server.address).make_safe(safe_state)
            assert twin.body.move is not None
            assert all(one.written and one.acknowledged and not one.safe for one in reports)
            assert "no pong" in reports[0].detail
            assert not twin.tracking, "tracking was ended over HTTP"

    trio.run(main)


@pytest.mark.parametrize("answer", [Answer(500, b""), Answer(p.OK, b'{"enabled": true}'), Answer(p.OK, b"[]")])
def test_saf_005_with_unknown_face_tracking_the_robot_does_not_count_as_held(answer: Answer) -> None:
    async def main() -> None:
        async with daemon() as (twin, server):
            write = twin._write
            twin._write = lambda target, data: (  # type: ignore[method-assign]
                answer if target == p.TRACKING_OFF else write(target, data)
            )
            reports = await channel(server.address).make_safe("hold")
            assert all(one.written and not one.safe for one in reports)
            assert twin.body.move is None and "not confirmed: " in reports[0].detail

    trio.run(main)


def test_saf_005_a_daemon_that_cannot_track_is_confirmed() -> None:
    async def main() -> None:
        async with daemon() as (twin, server):
            write = twin._write
            twin._write = lambda target, data: write(target.replace("tracking", "none"), data)  # type: ignore[method-assign]
            assert all(one.safe for one in await channel(server.address).make_safe("hold"))

    trio.run(main)


def test_saf_005_a_wire_without_messages_still_confirms_its_stop() -> None:
    """Its link was lost elsewhere, and the WebSocket is open."""

    async def main() -> None:
        async with daemon() as (twin, server):
            wire = ReachyWire(config(server.address), MonotonicClock())
            await wire.open()
            assert all(one.safe for one in await wire.reach("hold"))
            assert twin.body.move is None
            wire.close()

    trio.run(main)


def test_an_estop_takes_torque_first() -> None:
    assert frames("limp")[0] == p.MOTORS_OFF and frames("hold")[0] == p.STOP_MOVE
    assert set(frames("limp")) == {*frames("hold"), p.MOTORS_OFF}


# -- the wire


@asynccontextmanager
async def wired(*places: str) -> AsyncIterator[ReachyWire]:
    wire = ReachyWire(config(*places), MonotonicClock())
    await wire.open()
    async with trio.open_nursery() as nursery:
        await nursery.start(wire.serve)
        yield wire
        nursery.cancel_scope.cancel()
    wire.close()


def test_the_first_daemon_that_answers_is_it() -> None:
    async def main() -> None:
        async with daemon() as (_, server):
            wire = ReachyWire(config(NOWHERE, server.address), MonotonicClock())
            facts = await wire.open()
            assert facts["service"] == f"http://{server.address}" and facts["hardware"] == "Wireless"
            wire.close()
            with pytest.raises(WireDown, match=r"127\.0\.0\.1:9: cannot connect"):
                await ReachyWire(config(NOWHERE), MonotonicClock()).open()

    trio.run(main)


@pytest.mark.parametrize(
    ("status", "says"),
    [
        ({"state": "stopped"}, "the daemon is stopped. Start it"),
        ({"state": "running", "error": "no motor answers"}, r"the daemon is running \(no motor answers\)"),
        ({"state": 3}, "no state"),
    ],
)
def test_a_daemon_that_does_not_run_is_named(status: dict[str, object], says: str) -> None:
    async def main() -> None:
        async with daemon() as (twin, server):
            twin._status = lambda: status  # type: ignore[method-assign]
            with pytest.raises(WireDown, match=says):
                await ReachyWire(config(server.address), MonotonicClock()).open()

    trio.run(main)


@pytest.mark.parametrize("duration_s", [0.0, 2.0])
def test_saf_001_a_denied_setpoint_is_not_written(duration_s: float) -> None:
    async def main() -> None:
        async with daemon() as (twin, server):
            twin.body.end_move()
            async with wired(server.address) as wire:
                with pytest.raises(PermitDenied):
                    await wire.write((*FAR, duration_s), Free(0))
                with pytest.raises(PermitDenied):
                    await wire.perform("wake", {}, Free(0))
                await trio.sleep(0.1)
                assert twin.body.move is None and twin.body.target == (0.0,) * 9
                await wire.write((*FAR, duration_s), Free())
                await trio.sleep(0.1)
                assert twin.body.target != (0.0,) * 9

    trio.run(main)


def test_saf_010_a_command_waits_for_the_answer_to_the_one_before() -> None:
    async def main() -> None:
        async with daemon() as (twin, server):
            twin.body.end_move()
            async with wired(server.address) as wire:
                server.freeze(0.3)
                await wire.write((*FAR, 0.0), Free())
                with pytest.raises(PermitDenied, match="has not been answered"):
                    await wire.write((*FAR, 0.0), Free())

    trio.run(main)


def test_our_moves_do_not_count_as_another_clients() -> None:
    async def main() -> None:
        async with daemon() as (twin, server):
            twin.body.end_move()
            async with wired(server.address) as wire:
                for at in range(40):
                    # on a busy machine the previous write may be unanswered
                    with contextlib.suppress(PermitDenied):
                        await wire.write((*FAR[:7], float(at), 0.0, 2.0), Free())
                    await trio.sleep(0.013)
                    sensors = (await wire.read()).sensors
                    assert sensors["ignored"] == sensors["others_move"] == (0.0,)
                await wire.make_safe("hold")
                twin.body.play(Move("b9cbfc2f-79b0-4181-bce4-8ce04b277b90", [(FAR, 9.0)]))
                while (await wire.read()).sensors["others_move"] != (1.0,):  # noqa: ASYNC110  # ``daemon`` ends it
                    await trio.sleep(0.05)

    trio.run(main)


def test_saf_002_a_stop_does_not_overtake_a_command_that_waits_in_a_frozen_daemon() -> None:
    async def main() -> None:
        async with daemon() as (twin, server):
            twin.body.end_move()
            wire = ReachyWire(config(server.address), MonotonicClock())
            await wire.open()
            async with trio.open_nursery() as nursery:
                await nursery.start(wire.serve)
                server.freeze(0.25)
                await wire.write((*FAR, 9.0), Free())
                reports = await wire.make_safe("hold")
                assert all(one.safe for one in reports), reports[0].detail
                assert twin.body.move is None and twin.body.ended == []
                here = twin.body.position
                await trio.sleep(0.3)
                assert twin.body.position == pytest.approx(here, abs=0.5)
                nursery.cancel_scope.cancel()
            wire.close()

    trio.run(main)


class Slow(HttpPort):
    """A connection to a daemon that accepts a request to energise, and is busy for a while."""

    daemon: ReachyTwin
    nursery: trio.Nursery
    taken: trio.Event
    done: trio.Event

    async def ask(
        self, method: str, target: str, body: bytes = b"", *, permit: Permit | None = None, **more: Any
    ) -> Response:
        if method == "GET" or target == p.STOP:
            return await super().ask(method, target, body, permit=permit, **more)
        assert permit is not None
        permit.check()
        answers: list[Response] = []
        self.nursery.start_soon(self.carry_out, Request("POST", target, {}, body, b""), answers)
        self.taken.set()
        await self.done.wait()
        return answers[0]

    async def carry_out(self, request: Request, answers: list[Response]) -> None:
        """Carry out the request, even if its sender no longer waits."""
        await trio.sleep(0.3)
        answer = self.daemon.answer(request)
        answers.append(Response(answer.status, {}, answer.body))
        self.done.set()


@pytest.mark.parametrize(
    ("service", "given"),
    [
        ("motors", {"mode": "enabled"}),
        ("motors", {"mode": "gravity_compensation"}),
        ("wake", {}),
        ("turn_to_sound", {}),
        ("express", {"move": "yes1"}),
        ("track_face", {"enabled": True}),
    ],
)
def test_saf_010_no_stop_is_confirmed_before_a_services_request_is_carried_out(
    monkeypatch: pytest.MonkeyPatch, service: str, given: dict[str, object]
) -> None:
    monkeypatch.setattr(services, "HttpPort", Slow)

    async def main() -> None:
        async with daemon() as (twin, server), wired(server.address) as wire, trio.open_nursery() as nursery:
            twin.body.end_move()
            twin.body.set_mode("disabled")
            Slow.daemon, Slow.nursery, Slow.taken, Slow.done = twin, nursery, trio.Event(), trio.Event()
            scope = trio.CancelScope()

            async def perform() -> None:
                with scope:
                    await wire.perform(service, given, Free())
                assert scope.cancelled_caught, "the call does not report success"

            nursery.start_soon(perform)
            await Slow.taken.wait()
            scope.cancel()  # as a stop does
            reports = await wire.make_safe("limp")
            assert Slow.done.is_set(), "the request is carried out later"
            assert all(one.safe for one in reports), reports[0].detail
            await trio.sleep(0.3)
            assert (twin.body.mode, twin.body.move, twin.tracking) == ("disabled", None, False)

    trio.run(main)


def test_saf_010_a_request_that_is_carried_out_during_a_stop_is_followed_by_another_stop() -> None:
    """The answer comes just after the motors' mode was read."""

    async def main() -> None:
        async with daemon() as (twin, server):
            host, _, number = server.address.rpartition(":")
            stopper, owed = Stopper(host, int(number)), ["an answer"]
            look = stopper._look

            async def look_and_hear(safe_state: str) -> str:
                detail = await look(safe_state)
                if owed and not detail:
                    owed.clear()
                    twin.body.set_mode("enabled")
                return detail

            stopper._look = look_and_hear  # type: ignore[method-assign]
            assert await stopper.run("limp", STOP_S, lambda: bool(owed)) == "" and not owed
            assert twin.body.mode == "disabled"
            stopper.close()

    trio.run(main)


def test_saf_009_a_request_that_was_sent_does_not_count_as_denied() -> None:
    """A request without a body is complete with its head."""

    async def main() -> None:
        async with daemon() as (twin, server), wired(server.address) as wire:
            twin.body.end_move()
            with pytest.raises(PermitDenied):
                await wire.perform("motors", {"mode": "disabled"}, Free(0))
            assert twin.body.mode == "enabled"
            assert await wire.perform("motors", {"mode": "disabled"}, Free(1)) == {"mode": "disabled"}
            assert twin.body.mode == "disabled"

    trio.run(main)


@pytest.mark.parametrize("service", ["track_face", "motors"])
def test_saf_010_a_service_that_is_not_answered_ends_the_link(service: str) -> None:
    async def main() -> None:
        async with daemon() as (twin, server), wired(server.address) as wire:
            twin.body.end_move()
            server.freeze(1.7)
            with pytest.raises(WireDown, match="no answer within"):
                await wire.perform(service, {}, Free())
            with pytest.raises(WireDown, match=r"the daemon did not answer a request: .* no answer within"):
                await wire.read()
            with pytest.raises(WireDown, match="or an answer is missing"):
                await wire.write((*FAR, 0.0), Free())
            reports = await wire.reach("limp")
            assert all(one.safe for one in reports), reports[0].detail
            assert (twin.body.mode, twin.tracking) == ("disabled", False)

    trio.run(main)


def test_saf_012_frames_that_are_no_state_do_not_count() -> None:
    async def main() -> None:
        async with daemon() as (twin, server), wired(server.address) as wire:
            await wire.read()
            twin.set_fault(Fault.GARBAGE)
            await trio.sleep(1.3)
            with pytest.raises(WireDown, match=r"no state from the daemon for 1 s \(no JSON"):
                await wire.read()

    trio.run(main)

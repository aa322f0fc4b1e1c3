"""An e-stop from the mesh reaches the gate even while the loop of the robot's root is blocked."""

from __future__ import annotations

import json
import socket
import threading
import time

import pytest
import trio
import zenoh

from strands_actors.caller.processes.run_directory import Name
from strands_actors.contract.driver import Reason
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.kernel.channels.zenoh_session import config, unix_endpoint
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.node import Node
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import GetStatus, Stop, StopReport
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.service import MeshService
from strands_actors.supervisors.root.messages import TaskStatus
from strands_actors.testing.fake import HARDWARE, FakeDriver, FakeHardware

from .world import run, until

ROBOT = "arm"
HELD_UP_S = 0.6


class Gate(Actor):
    """The gate, in another process. It records the received messages with their times."""

    def __init__(self, received: list[tuple[float, Stop]]) -> None:
        self._told = received

    def receive(self, message: Stop | GetStatus) -> StopReport | None:
        if not isinstance(message, Stop):
            return None
        self._told.append((time.monotonic(), message))
        return StopReport(message.reason, "limp", 2, True, ())


def test_saf_007_an_estop_waits_for_no_loop_of_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(HARDWARE, ROBOT, FakeHardware())
    received: list[tuple[float, Stop]] = []
    ours, theirs = socket.socketpair()

    async def wire() -> None:
        node = Node("wire", MonotonicClock())
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            await nursery.start(node.cell(addresses.of(ROBOT).path("gate"), lambda: Gate(received)).run)
            await Link(node, theirs).run()
            nursery.cancel_scope.cancel()

    thread = threading.Thread(target=trio.run, args=(wire,), daemon=True)
    thread.start()

    async def test() -> None:
        name = Name(ROBOT)
        endpoint = unix_endpoint(name.socket("mesh"))
        node = Node("root", MonotonicClock())
        service = MeshService(node, ROBOT, FakeDriver("fake", ROBOT, {}), TaskStatus)
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            await nursery.start(Link(node, ours).run)
            nursery.start_soon(service.run, [endpoint], [], {})
            await service.settled.wait()
            await until(lambda: node.route(addresses.of(ROBOT).gate), "the gate is known")
            session = await trio.to_thread.run_sync(zenoh.open, config([], [endpoint], {}))
            answers: list[dict[str, object]] = []
            subscriber = session.declare_subscriber(
                mesh_json.response_key("the-button", ROBOT, "press-1"),
                lambda sample: answers.append(json.loads(sample.payload.to_bytes())),
            )
            await trio.sleep(0.5)  # until the two sessions have exchanged their subscriptions
            order = {"sender_id": "the-button", "turn_id": "press-1", "by": "the button"}
            press = threading.Timer(0.1, session.put, (mesh_json.ESTOP_KEY, json.dumps(order).encode()))
            press.start()
            time.sleep(HELD_UP_S)  # noqa: ASYNC251  # block the loop, which would have read it
            over_s = time.monotonic()
            assert received, "the gate did not receive the e-stop"
            at_s, stop = received[0]
            assert at_s < over_s - HELD_UP_S / 3
            assert (stop.reason, stop.by, stop.lock) == (Reason.ESTOP, "the button", True)
            await until(lambda: answers, "who pressed is told what became of it")
            assert len(received) == 1, "the gate received a second e-stop"
            subscriber.undeclare()
            await trio.to_thread.run_sync(session.close)
            service.close()
            nursery.cancel_scope.cancel()
        name.release()

    run(test)
    thread.join(20.0)


def test_an_early_handler_passes_its_result_to_the_loop_and_delays_no_other_message() -> None:
    """The early handler runs in zenoh's thread. The loop then gets the samples in their order."""
    by_thread: list[int] = []
    messages: list[tuple[str, str | None, int]] = []

    def at_once(received: Received) -> str | None:
        by_thread.append(threading.get_ident())
        text = received.payload.decode()
        return f"did {text}" if text.startswith("urgent") else None

    def handle(received: Received) -> None:
        messages.append((received.payload.decode(), received.done, threading.get_ident()))

    async def test() -> None:
        name = Name("topics")
        endpoint = unix_endpoint(name.socket("mesh"))
        there, here = await PubSub.open([endpoint]), await PubSub.open([], [endpoint])
        there.subscribe("strands/bench/cmd", handle, at_once=at_once)
        async with trio.open_nursery() as nursery:
            await nursery.start(there.run)
            await nursery.start(here.run)
            await until(lambda: here.connections, "a connection")
            while not messages:
                here.put("strands/bench/cmd", b"first", "command")
                await trio.sleep(0.02)
            for text in ("urgent 1", "later", "urgent 2"):
                here.put("strands/bench/cmd", text.encode(), "command")
            await until(lambda: messages[-1][0] == "urgent 2", "all of them")
            here.close()
            there.close()
        name.release()

    run(test)
    me = threading.get_ident()
    expected = [("urgent 1", "did urgent 1", me), ("later", None, me), ("urgent 2", "did urgent 2", me)]
    assert messages[-3:] == expected
    assert me not in by_thread

"""Measure a stop from a process that also sends telemetry at full speed: ``python -m benchmarks.sides.estop SIDE
[short]``.

SIDE is the name of the program that is measured. With ``short`` the run is short.

The measured time begins before the stop is sent and ends when the receiver's handler runs. The telemetry
consists of readings of 1 kB. The receiver computes for 5 us per reading.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from typing import Any

import trio

from benchmarks.house import Figures
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node
from strands_actors.kernel.processes.process import start

from .common import answer, percentiles

READING = b"x" * 1000
WORK_NS = 5_000
PERIOD_S = 0.02
SETTLE_S = 0.5
ADDRESS = "strands/bench/actor/stopper"
ENTRY = "benchmarks.sides.estop:send"


class EStop(Message, frozen=True):
    lane = "urgent"

    sent_ns: int


def stops(short: bool) -> int:
    return 50 if short else 300


def work() -> None:
    until_ns = time.perf_counter_ns() + WORK_NS
    while time.perf_counter_ns() < until_ns:
        pass


def figures(spans_ns: list[int], received: int, began_s: float) -> Figures:
    return percentiles("estop", spans_ns) | {"taken_per_s": received / (time.perf_counter() - began_s)}


# -- ours


def send(args: dict[str, Any], sock: socket.socket) -> None:
    """Run the child process with this package: one thread sends telemetry at full speed, and the trio loop sends
    stops.
    """
    trio.run(_send, args)


async def _send(args: dict[str, Any]) -> None:
    from strands_actors.kernel.channels.pubsub import PubSub
    from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh

    mesh = await ZenohMesh.open([], [args["actors"]])
    topics = await PubSub.open([], [args["topics"]])
    node = Node("there", MonotonicClock(), mesh)
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        mesh.attach(node)
        await nursery.start(mesh.run)
        ref = node.ref(ADDRESS)
        topic = topics.topic("bench/state", "bench.state.v1")
        await trio.sleep(SETTLE_S)

        def flood() -> None:
            while True:
                if topic.has_subscribers:
                    topic.put(READING)

        threading.Thread(target=flood, daemon=True).start()
        await trio.sleep(SETTLE_S)
        while True:
            ref.tell(EStop(time.monotonic_ns()))
            await trio.sleep(PERIOD_S)


async def ours(short: bool) -> Figures:
    from strands_actors.kernel.channels.pubsub import PubSub
    from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
    from strands_actors.kernel.channels.zenoh_session import unix_endpoint

    spans_ns: list[int] = []
    done = trio.Event()

    class Stopper(Actor):
        def receive(self, message: EStop) -> None:
            spans_ns.append(time.monotonic_ns() - message.sent_ns)
            if len(spans_ns) == stops(short):
                done.set()

    received = 0

    async def take(topics: PubSub) -> None:
        nonlocal received
        poll = topics.poll(1, "bench/state")
        async for _ in MonotonicClock().ticks(0.001):
            if poll.take() is not None:
                received += 1
                work()

    with tempfile.TemporaryDirectory() as directory:
        endpoints = {name: unix_endpoint(f"{directory}/{name}") for name in ("actors", "topics")}
        mesh, topics = await ZenohMesh.open([endpoints["actors"]]), await PubSub.open([endpoints["topics"]])
        node = Node("here", MonotonicClock(), mesh)
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            await nursery.start(node.cell("bench/actor/stopper", Stopper).run)
            mesh.attach(node)
            await nursery.start(mesh.run)
            nursery.start_soon(take, topics)
            child = start(ENTRY, endpoints)
            began_s = time.perf_counter()
            with trio.fail_after(60):
                await done.wait()
            result = figures(spans_ns, received, began_s)
            await child.fence()
            nursery.cancel_scope.cancel()
        # The session is closed only after the loop has ended, because a closed session cannot be polled.
        mesh.close()
        topics.close()
    return result


# -- plain zenoh: one callback for the readings and one for the stops, as in zenoh's examples


def plain(short: bool) -> Figures:
    from .between import _session

    spans_ns: list[int] = []
    received = 0
    done = threading.Event()

    def reading(_: object) -> None:
        nonlocal received
        received += 1
        work()

    def stop(sample: Any) -> None:
        spans_ns.append(time.monotonic_ns() - int(sample.payload.to_bytes()))
        if len(spans_ns) == stops(short):
            done.set()

    with tempfile.TemporaryDirectory() as directory:
        path = f"{directory}/there"
        with _session([path], []) as session:
            subscribers = [
                session.declare_subscriber("bench/state", reading),
                session.declare_subscriber("bench/stop", stop),
            ]
            sender = subprocess.Popen([sys.executable, "-m", "benchmarks.sides.estop", "plain-sender", path])
            began_s = time.perf_counter()
            try:
                assert done.wait(60), f"only {len(spans_ns)} stops came"
                result = figures(spans_ns, received, began_s)
            finally:
                sender.kill()
                sender.wait()
                for subscriber in subscribers:
                    subscriber.undeclare()
    return result


def plain_sender(path: str) -> None:
    from .between import _session

    session = _session([], [path])
    readings, halt = session.declare_publisher("bench/state"), session.declare_publisher("bench/stop")
    time.sleep(SETTLE_S)

    def flood() -> None:
        while True:
            readings.put(READING)

    threading.Thread(target=flood, daemon=True).start()
    time.sleep(SETTLE_S)
    while True:
        halt.put(str(time.monotonic_ns()).encode())
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    if sys.argv[1] == "plain-sender":
        plain_sender(sys.argv[2])
    else:
        answer({"ours": lambda short: trio.run(ours, short), "plain zenoh": plain})
        sys.stdout.flush()
        os._exit(0)  # zenoh's callbacks would delay a normal exit

"""Measure messages between two processes: ``python -m benchmarks.sides.between SIDE [short]``.

SIDE is the name of the program that is measured. With ``short`` the run is short.

An ask is a request with an answer, here with a deadline of 1 s. A tell is a message without an answer, here a
robot's state of 217 bytes. Tells are sent in groups that fit into the receiver's mailbox. After each group the
sender asks how many tells have arrived.
"""

from __future__ import annotations

import asyncio
import os
import socket
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

import msgspec
import trio

from benchmarks.house import Figures
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.mailbox import CAPACITY
from strands_actors.kernel.node import Node, Ref, Unreachable
from strands_actors.kernel.processes.process import start

from .common import STATE, Count, Counter, GetCount, State, answer, percentiles

DEADLINE_S = 1.0
WINDOW = CAPACITY - 1
ADDRESS = "strands/bench/actor/one"
WARM = 200
CHILD = "benchmarks.sides.between"
QUESTION = b"12345678"


def asks(short: bool) -> int:
    return 500 if short else 4_000


def windows(short: bool) -> int:
    return 10 if short else 100


def rate(messages: int, began_s: float) -> Figures:
    return {"tell_per_s": messages / (time.perf_counter() - began_s)}


# -- ours


def serve(args: dict[str, Any], sock: socket.socket) -> None:
    """Run an actor of this package in a child process. It counts messages from zenoh, and receives them as the
    processes of a robot do.
    """
    from strands_actors.kernel.channels.zenoh_session import hand_over

    hand_over()
    trio.run(_serve, args)


async def _serve(args: dict[str, Any]) -> None:
    from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh

    mesh = await ZenohMesh.open([args["endpoint"]])
    node = Node("there", MonotonicClock(), mesh)
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(node.cell("bench/actor/one", Counter).run)
        mesh.attach(node)
        await nursery.start(mesh.run)


@asynccontextmanager
async def reached() -> AsyncIterator[Ref]:
    """Start an actor that counts messages in another process. Yield a reference, through which messages reach it by
    zenoh.
    """
    from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
    from strands_actors.kernel.channels.zenoh_session import hand_over, unix_endpoint

    hand_over()
    with tempfile.TemporaryDirectory() as directory:
        endpoint = unix_endpoint(f"{directory}/there")
        child = start(f"{CHILD}:serve", {"endpoint": endpoint})
        try:
            mesh = await ZenohMesh.open([], [endpoint])
            node = Node("here", MonotonicClock(), mesh)
            async with trio.open_nursery() as nursery:
                await nursery.start(node.run)
                mesh.attach(node)
                await nursery.start(mesh.run)
                ref = node.ref(ADDRESS, Counter)
                await answering(ref)
                yield ref
                mesh.close()
                nursery.cancel_scope.cancel()
        finally:
            await child.fence()


async def answering(ref: Ref) -> None:
    with trio.fail_after(20):
        while True:
            try:
                await ref.ask(GetCount(), DEADLINE_S)
            except Unreachable:
                await trio.sleep(0.01)
            else:
                return


async def ours(short: bool) -> Figures:
    async with reached() as ref:
        spans_ns = await _timed(asks(short), lambda: ref.ask(GetCount(), DEADLINE_S))
        began_s = time.perf_counter()
        for number in range(windows(short)):
            for _ in range(WINDOW):
                ref.tell(STATE)
            assert await ref.ask(GetCount(), 30.0) == Count((number + 1) * WINDOW)
        return percentiles("ask", spans_ns) | rate(windows(short) * WINDOW, began_s)


# -- for comparison: zenoh and a socket, without actors, deadlines or types


def zenoh_pair(short: bool) -> Figures:
    """Measure one zenoh message to another process and one back, without actors or a loop. As in this package, the
    messages have real-time priority and are sent at once (``express``).
    """
    import zenoh

    with _answered_by("zenoh-server") as (session, put):
        answers = session.declare_subscriber("bench/back", zenoh.handlers.FifoChannel(1024))
        # Wait until zenoh also knows the route of the answers.
        time.sleep(0.3)

        def ask() -> None:
            put(QUESTION)
            answers.recv()

        return percentiles("ask", timed(asks(short), ask))


@contextmanager
def _answered_by(server: str) -> Iterator[tuple[Any, Callable[[bytes], None]]]:
    """Start a child process that runs ``server``. Yield a zenoh session, and a function that sends a message to
    the child.
    """
    import subprocess

    with tempfile.TemporaryDirectory() as directory:
        path = f"{directory}/there"
        child = subprocess.Popen([sys.executable, "-m", CHILD, server, path], stdout=subprocess.PIPE)
        assert child.stdout is not None
        try:
            child.stdout.readline()
            with _session([], [path]) as session:
                publisher = _publisher(session, "bench/one")
                while not publisher.matching_status.matching:
                    time.sleep(0.01)
                yield session, publisher.put
        finally:
            child.kill()
            child.wait()


def zenoh_server(path: str) -> None:
    with _session([path], []) as session:
        put = _publisher(session, "bench/back")
        _subscriber = session.declare_subscriber("bench/one", lambda sample: put.put(sample.payload.to_bytes()))
        print("ready", flush=True)
        time.sleep(1000)


def _session(listen: list[str], connect: list[str]) -> Any:
    """Open a zenoh session with the default settings, as users do, but without searching the network for peers."""
    import zenoh

    config = zenoh.Config()
    config.insert_json5("mode", '"peer"')
    config.insert_json5("scouting/multicast/enabled", "false")
    for key, paths in (("listen", listen), ("connect", connect)):
        endpoints = msgspec.json.encode([f"unixsock-stream/{path}" for path in paths]).decode()
        config.insert_json5(f"{key}/endpoints", endpoints)
    return zenoh.open(config)


def _publisher(session: Any, key: str) -> Any:
    import zenoh

    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.BLOCK,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
    )


def zenoh_into_trio(short: bool) -> Figures:
    """Measure the two zenoh messages of ``zenoh_pair`` if a trio loop receives each of them, with a deadline.

    This is the smallest cost for a process that keeps its state in one loop. Messages without an answer are
    measured, too: the loop decodes and counts each.
    """
    with _answered_by("loop-server") as (session, put):
        return trio.run(_ask_in_trio, session, put, short)


async def _ask_in_trio(session: Any, put: Callable[[bytes], None], short: bool) -> Figures:
    with _subscribed(session, "bench/back") as answers:

        async def counted(within_s: float = DEADLINE_S) -> int:
            with trio.fail_after(within_s):
                put(QUESTION)
                return int.from_bytes(await answers.receive(), "little")

        # Wait until zenoh also knows the route of the answers.
        await trio.sleep(0.3)
        spans_ns = await _timed(asks(short), counted)
        began_s = time.perf_counter()
        for number in range(windows(short)):
            for _ in range(WINDOW):
                put(msgspec.msgpack.encode(STATE))
            assert await counted(30.0) == (number + 1) * WINDOW
        return percentiles("ask", spans_ns) | rate(windows(short) * WINDOW, began_s)


async def loop_server(path: str) -> None:
    count = 0
    with _session([path], []) as session, _subscribed(session, "bench/one") as requests:
        put = _publisher(session, "bench/back")
        print("ready", flush=True)
        async for payload in requests:
            if payload == QUESTION:
                put.put(count.to_bytes(8, "little"))
            else:
                msgspec.msgpack.decode(payload, type=State)
                count += 1


@contextmanager
def _subscribed(session: Any, key: str) -> Iterator[trio.MemoryReceiveChannel[bytes]]:
    """Subscribe to a zenoh key. Yield a channel from which a trio loop receives the messages."""
    import zenoh

    sends, receives = trio.open_memory_channel[bytes](1024)
    token = trio.lowlevel.current_trio_token()

    def on_sample(sample: Any) -> None:
        token.run_sync_soon(sends.send_nowait, sample.payload.to_bytes())

    subscriber = session.declare_subscriber(key, zenoh.handlers.Callback(on_sample, indirect=False))
    try:
        yield receives
    finally:
        subscriber.undeclare()


def unix_socket(short: bool) -> Figures:
    """Measure the time for sending eight bytes through a blocking socket pair and receiving them back."""
    ours, theirs = socket.socketpair()
    if (pid := os.fork()) == 0:
        ours.close()
        while data := theirs.recv(65536):
            theirs.sendall(data)
        os._exit(0)
    theirs.close()
    spans_ns = []
    for _ in range(asks(short)):
        began_ns = time.perf_counter_ns()
        ours.sendall(QUESTION)
        ours.recv(65536)
        spans_ns.append(time.perf_counter_ns() - began_ns)
    ours.close()
    os.waitpid(pid, 0)
    return percentiles("ask", spans_ns)


# -- others


def timed(n: int, ask: Callable[[], object]) -> list[int]:
    for _ in range(WARM):
        ask()
    spans_ns = []
    for _ in range(n):
        began_ns = time.perf_counter_ns()
        ask()
        spans_ns.append(time.perf_counter_ns() - began_ns)
    return spans_ns


def ray(short: bool) -> Figures:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    import ray

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, configure_logging=False)
    try:

        @ray.remote
        class Counter:
            def __init__(self) -> None:
                self.n = 0

            def state(self, state: bytes) -> None:
                msgspec.msgpack.decode(state, type=State)
                self.n += 1

            def count(self) -> int:
                return self.n

        actor = Counter.remote()  # type: ignore[attr-defined]
        # The first answer means that the actor's process has started.
        ray.get(actor.count.remote(), timeout=60)
        spans_ns = timed(asks(short), lambda: ray.get(actor.count.remote(), timeout=DEADLINE_S))
        began_s = time.perf_counter()
        some = max(1, windows(short) // 10)
        for _ in range(some):
            for _ in range(WINDOW):
                actor.state.remote(msgspec.msgpack.encode(STATE))
            ray.get(actor.count.remote(), timeout=60)
        figures = rate(some * WINDOW, began_s)
        assert ray.get(actor.count.remote()) == some * WINDOW
        return percentiles("ask", spans_ns) | figures
    finally:
        ray.shutdown()


def thespian(short: bool) -> Figures:
    from thespian.actors import ActorSystem

    from .thespian_counter import Counter as Theirs

    system = ActorSystem("multiprocTCPBase", logDefs={"version": 1})
    try:
        actor = system.createActor(Theirs)
        spans_ns = timed(asks(short) // 4, lambda: system.ask(actor, "count", DEADLINE_S))
        began_s = time.perf_counter()
        some = max(1, windows(short) // 10)
        for _ in range(some):
            for _ in range(WINDOW):
                system.tell(actor, msgspec.msgpack.encode(STATE))
            counted = system.ask(actor, "count", 60)
        assert counted == some * WINDOW, counted
        return percentiles("ask", spans_ns) | rate(some * WINDOW, began_s)
    finally:
        system.shutdown()


async def xoscar(short: bool) -> Figures:
    import xoscar

    from .xoscar_counter import Counter as Theirs

    pool = await xoscar.create_actor_pool("127.0.0.1", n_process=1)
    try:
        address = pool.external_address
        process_index = (await xoscar.get_pool_config(address)).get_process_indexes()[1]
        place = (await xoscar.get_pool_config(address)).get_external_address(process_index)
        actor = await xoscar.create_actor(Theirs, address=place)

        async def ask() -> None:
            async with asyncio.timeout(DEADLINE_S):
                await actor.count()

        spans_ns = await _timed(asks(short), ask)
        began_s = time.perf_counter()
        some = max(1, windows(short) // 10)
        for _ in range(some):
            for _ in range(WINDOW):
                await actor.state.tell(msgspec.msgpack.encode(STATE))
            counted = await actor.count()
        assert counted == some * WINDOW, counted
        return percentiles("ask", spans_ns) | rate(some * WINDOW, began_s)
    finally:
        await pool.stop()


async def _timed(n: int, ask: Callable[[], Awaitable[object]]) -> list[int]:
    for _ in range(WARM):
        await ask()
    spans_ns = []
    for _ in range(n):
        began_ns = time.perf_counter_ns()
        await ask()
        spans_ns.append(time.perf_counter_ns() - began_ns)
    return spans_ns


if __name__ == "__main__":
    if sys.argv[1] == "zenoh-server":
        zenoh_server(sys.argv[2])
    elif sys.argv[1] == "loop-server":
        trio.run(loop_server, sys.argv[2])
    else:
        answer(
            {
                "ours": lambda short: trio.run(ours, short),
                "zenoh": zenoh_pair,
                "zenoh into trio": zenoh_into_trio,
                "socket": unix_socket,
                "ray": ray,
                "thespian": thespian,
                "xoscar": lambda short: asyncio.run(xoscar(short)),
            }
        )

"""Some work so many times, for who counts: ``python -m benchmarks.sides.instructions SIDE WORK TIMES``.

``tell``: a message in and handled, in bursts of 100. ``ask``: the same with its answer and a deadline.
``setpoint``: a G1's, from the frame that came to the frame that leaves: decoded, all gates, encoded.
``state``: a LowState, decoded.
"""

from __future__ import annotations

import asyncio
import math
import sys
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import trio

from .common import STATE, Counter, GetCount, hosted

BURST = 100


async def our_tells(times: int) -> None:
    async with hosted(Counter) as (one, _):
        for _ in range(times // BURST):
            for _ in range(BURST):
                one.tell(STATE)
            await trio.lowlevel.checkpoint()


async def our_asks(times: int) -> None:
    async with hosted(Counter) as (one, _):
        for _ in range(times):
            await one.ask(GetCount(), 1.0)


def our_setpoints(times: int) -> None:
    from strands_actors.drivers.unitree.link import CDR
    from strands_actors.drivers.unitree.protocol import CommandCodec
    from strands_actors.runtime.columns import by_column
    from strands_actors.runtime.contract import Candidate, GateState, Observation
    from strands_actors.runtime.frames import decode_frame, frame, protocol_of
    from strands_actors.supervisors.gate import Gate
    from strands_actors.supervisors.messages import Setpoint
    from strands_actors.testing.bench import driver_of

    driver: Any = driver_of("unitree_g1")
    count = len(driver.axes)
    action: dict[str, Any] = {axis: {"q": 0.01, "kp": 200.0, "kd": 6.0} for axis in driver.axes}
    setpoint: Any = Setpoint(1, 1, 10**18, {}, 0.002, False, by_column(action) or {})
    sent = frame("strands/g1/actor/gate", 0, 0, "policy", "node", setpoint)
    decode, codec, now_ns = protocol_of(Gate).decode, CommandCodec(driver.model), time.monotonic_ns()
    sensors: dict[str, tuple[float, ...]] = {"battery": (90.0, now_ns / 1e9), "fsm": (500.0, now_ns / 1e9)}
    seen = Observation(now_ns, (0.0,) * count, (now_ns,) * count, (0.0,) * count, sensors, {})
    target = (*(0.01,) * count, *(0.0,) * (2 * count), *(200.0,) * count, *(6.0,) * count)
    state = GateState(now_ns, seen, target, now_ns, True, 0.002)
    for _ in range(times):
        setpoint = decode(decode_frame(sent).body)
        assert not any(condition.check(seen, now_ns) for condition in driver.conditions)
        candidate = driver.parse_columns(setpoint.columns, state)
        assert isinstance(candidate, Candidate)
        assert not any(gate(candidate, state) for gate in driver.gates)
        assert len(CDR + codec.encode(5, candidate.values)) > count


def our_states(times: int) -> None:
    from strands_actors.drivers.unitree.protocol import State, StateCodec
    from strands_actors.testing.bench import driver_of

    driver: Any = driver_of("unitree_g1")
    codec, zero = StateCodec(driver.model), (0.0,) * len(driver.axes)
    rest = ((1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3)
    body = memoryview(codec.encode(State(5, 1, *rest, zero, zero, zero, (30,) * len(zero), None)))
    for _ in range(times):
        codec.decode(body)


async def trio_tells(times: int) -> None:
    sender, receiver = trio.open_memory_channel[Any](math.inf)

    async def count() -> None:
        async for _ in receiver:
            pass

    async with trio.open_nursery() as nursery:
        nursery.start_soon(count)
        for _ in range(times):
            sender.send_nowait(STATE)
        sender.close()


async def trio_asks(times: int) -> None:
    from .ask import trio_channel

    await trio_channel(times)


async def asyncio_tells(times: int) -> None:
    queue: asyncio.Queue[Any] = asyncio.Queue(BURST)

    async def count() -> None:
        while True:
            await queue.get()

    reader = asyncio.create_task(count())
    for _ in range(times // BURST):
        for _ in range(BURST):
            queue.put_nowait(STATE)
        await asyncio.sleep(0)
    reader.cancel()


def bare_tells(times: int) -> None:
    """What no actor can do without."""
    counter, waiting = Counter(), deque[Any]()
    for _ in range(times // BURST):
        for _ in range(BURST):
            waiting.append(STATE)
        while waiting:
            counter.receive(waiting.popleft())


WORKS: dict[tuple[str, str], Callable[[int], Any]] = {
    ("ours", "tell"): lambda times: trio.run(our_tells, times),
    ("ours", "ask"): lambda times: trio.run(our_asks, times),
    ("ours", "setpoint"): our_setpoints,
    ("ours", "state"): our_states,
    ("trio", "tell"): lambda times: trio.run(trio_tells, times),
    ("trio", "ask"): lambda times: trio.run(trio_asks, times),
    ("asyncio", "tell"): lambda times: asyncio.run(asyncio_tells(times)),
    ("bare", "tell"): bare_tells,
}

if __name__ == "__main__":
    WORKS[sys.argv[1], sys.argv[2]](int(sys.argv[3]))

"""All messages of a burst arrive, also on a busy machine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial

import pytest
import trio

from strands_actors.caller.processes.run_directory import Name
from strands_actors.kernel.channels.pubsub import PubSub
from strands_actors.kernel.channels.zenoh_session import unix_endpoint
from tests.spinning import spinning

from .world import until

BURST = 12
ROUNDS = 30


@pytest.fixture
def every_core_taken() -> Iterator[None]:
    with spinning(2 * (os.cpu_count() or 1)):
        yield


def all_there(received: list[str], sent: list[str]) -> bool:
    return received[-len(sent) :] == sent


@pytest.mark.usefixtures("every_core_taken")
def test_a_burst_of_commands_arrives_complete_on_a_busy_machine() -> None:
    async def test() -> None:
        name = Name("burst")
        endpoint = unix_endpoint(name.socket("mesh"))
        there, here = await PubSub.open([endpoint]), await PubSub.open([], [endpoint])
        messages: list[str] = []
        there.subscribe("strands/bench/cmd", lambda received: messages.append(received.payload.decode()))
        async with trio.open_nursery() as nursery:
            await nursery.start(there.run)
            await nursery.start(here.run)
            await until(lambda: here.connections, "a connection")
            while not messages:  # wait until the subscription is active, too
                here.put("strands/bench/cmd", b"first", "command")
                await trio.sleep(0.02)
            for burst in range(ROUNDS):
                sent = [f"{burst}.{number}" for number in range(BURST)]
                for text in sent:
                    here.put("strands/bench/cmd", text.encode(), "command")
                await until(partial(all_there, messages, sent), f"{sent}, heard {messages}", 5.0)
            here.close()
            there.close()
        name.release()

    trio.run(test)

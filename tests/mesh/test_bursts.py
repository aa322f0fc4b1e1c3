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


def all_there(heard: list[str], sent: list[str]) -> bool:
    return heard[-len(sent) :] == sent


@pytest.mark.usefixtures("every_core_taken")
def test_commands_put_in_a_row_all_arrive_although_nobody_has_a_core_to_send_them() -> None:
    async def test() -> None:
        name = Name("burst")
        endpoint = unix_endpoint(name.socket("mesh"))
        there, here = await PubSub.open([endpoint]), await PubSub.open([], [endpoint])
        heard: list[str] = []
        there.subscribe("strands/bench/cmd", lambda received: heard.append(received.payload.decode()))
        async with trio.open_nursery() as nursery:
            await nursery.start(there.run)
            await nursery.start(here.run)
            await until(lambda: here.connections, "a connection")
            while not heard:  # the subscription has arrived as well
                here.put("strands/bench/cmd", b"first", "command")
                await trio.sleep(0.02)
            for burst in range(ROUNDS):
                sent = [f"{burst}.{number}" for number in range(BURST)]
                for text in sent:
                    here.put("strands/bench/cmd", text.encode(), "command")
                await until(partial(all_there, heard, sent), f"{sent}, heard {heard}", 5.0)
            here.close()
            there.close()
        name.release()

    trio.run(test)

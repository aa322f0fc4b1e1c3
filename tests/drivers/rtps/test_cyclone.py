"""Test CycloneDDS 0.10 as the peer, with Unitree's types and the type information that a robot sends."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.drivers.common.rtps import Participant, Reader, Writer, open_participant

from .cyclone_library import library
from .cyclone_peer import TOPICS

PATIENCE_S = 30.0
DOMAIN = 100 + os.getpid() % 50  # two runs of these tests on one machine use different domains
OURS = "127.0.0.40"
COMMAND, STATE, REQUEST, RESPONSE = TOPICS
HEAD = b"\x00\x01\x00\x00"

CONFIG = """
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1" multicast="{multicast}"/></Interfaces>
    <AllowMulticast>{multicast}</AllowMulticast>
  </General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex>{peers}</Discovery>
</Domain></CycloneDDS>
"""


# Unitree's layouts, from independent sources and not from this project's codec.


def command_image(cdr: bytes) -> bytes:
    """Return the C struct of a LowCmd, with the padding that CDR leaves out before the first motor."""
    return cdr[0:2] + bytes(2) + cdr[2:3] + bytes(3) + cdr[4:]


def state_image(cdr: bytes) -> bytes:
    return cdr[0:70] + bytes(2) + cdr[70:71] + bytes(3) + cdr[72:]


def low_command(number: int) -> bytes:
    body = bytearray(number + at & 0xFF for at in range(1000))
    for motor in range(35):  # three bytes of padding behind each mode
        at = 2 if motor == 0 else 28 * motor
        body[at + 1 : 28 * motor + 4] = bytes(28 * motor + 3 - at)
    return bytes(body)


def low_state(number: int) -> bytes:
    body = bytearray(number + at & 0xFF for at in range(2088))
    body[10:12] = bytes(2)
    for motor in range(35):
        at = 70 if motor == 0 else 68 + 56 * motor
        body[at + 1 : 72 + 56 * motor] = bytes(71 + 56 * motor - at)
    return bytes(body)


def text(value: str) -> bytes:
    characters = value.encode() + b"\x00"
    return struct.pack("<I", len(characters)) + characters + bytes(-len(characters) % 4)


def request(number: int, api: int, parameter: str) -> bytes:
    header = struct.pack("<qqqi?3x", number, api, 0, 0, False)
    return HEAD + header + text(parameter) + struct.pack("<I", 0)


def response(number: int, api: int, code: int, data: str) -> bytes:
    return HEAD + struct.pack("<qqi", number, api, code) + text(data) + struct.pack("<I", 0)


def parsed(payload: bytes) -> tuple[int, int, int, str]:
    """Return id, api id, code and text of a response."""
    number, api, code, length = struct.unpack_from("<qqiI", payload, 4)
    return number, api, code, payload[28 : 27 + length].decode()


class Cyclone:
    def __init__(self, process: trio.Process) -> None:
        self._process = process
        self.said: list[dict[str, Any]] = []

    async def listen(self) -> None:
        rest = b""
        assert self._process.stdout is not None
        async for read in self._process.stdout:
            *lines, rest = (rest + read).split(b"\n")
            self.said += [json.loads(line) for line in lines]

    async def do(self, **order: object) -> None:
        assert self._process.stdin is not None
        await self._process.stdin.send_all(json.dumps(order).encode() + b"\n")

    async def until(self, found: Callable[[list[dict[str, Any]]], Any]) -> Any:
        while not (seen := found(self.said)):  # noqa: ASYNC110
            await trio.sleep(0.002)
        return seen

    async def until_it_has_matched(self, *topics: str) -> None:
        for topic in topics:
            while True:
                self.said.clear()
                await self.do(do="matched", topic=topic)
                (answer,) = await self.until(lambda said: [line for line in said if "matched" in line])
                if answer["matched"]:
                    break

    def images(self, topic: str) -> list[str]:
        return [line["image"] for line in self.said if line.get("topic") == topic]


@asynccontextmanager
async def cyclone(multicast: bool, **options: object) -> AsyncIterator[Cyclone]:
    peers = "" if multicast else f'<Peers><Peer address="{OURS}"/></Peers>'
    config = CONFIG.format(multicast=str(multicast).lower(), peers=peers)
    given = json.dumps({"domain": DOMAIN, "config": config, **options})
    script = Path(__file__).parent / "cyclone_peer.py"
    environment = {key: value for key, value in os.environ.items() if key != "CYCLONEDDS_URI"}
    async with trio.open_nursery() as nursery:
        command = [sys.executable, str(script), str(library()), given]
        process = await trio.lowlevel.open_process(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
        )
        try:
            peer = Cyclone(process)
            nursery.start_soon(peer.listen)
            await peer.until(lambda said: {"ready": True} in said)
            yield peer
            assert process.stdin is not None
            await process.stdin.aclose()
            assert await process.wait() == 0  # a crash of the peer counts as our fault, too
        finally:
            process.kill()
            with trio.CancelScope(shield=True):
                await process.wait()


class Robotics:
    """Our participant with a writer or a reader of each topic."""

    def __init__(self, participant: Participant, writes: list[str], reads: list[str], **qos: bool) -> None:
        self.heard: dict[str, list[bytes]] = {topic: [] for topic in reads}
        self.writers: dict[str, Writer] = {
            topic: participant.writer(topic, TOPICS[topic], **qos) for topic in writes
        }
        self.readers: dict[str, Reader] = {
            topic: participant.reader(topic, TOPICS[topic], self._listener(topic), **qos) for topic in reads
        }

    def _listener(self, topic: str) -> Callable[[memoryview, bytes, int], None]:
        return lambda payload, writer, t_ns: self.heard[topic].append(bytes(payload))

    async def matched(self, participant: Participant) -> None:
        await participant.wait_matched(*self.writers.values(), *self.readers.values())


def run(main: Callable[[], Any]) -> None:
    async def bounded() -> None:
        with trio.fail_after(PATIENCE_S):
            await main()

    library()  # downloaded before the clock runs
    trio.run(bounded)


@pytest.mark.parametrize("multicast", [True, False])
@pytest.mark.parametrize(("reliable", "transient_local"), [(False, False), (True, False), (True, True)])
def test_our_driver_and_a_cyclone_robot(multicast: bool, reliable: bool, transient_local: bool) -> None:
    """We send LowCmd and a request. Cyclone sends LowState, in fragments, and the response."""
    qos = {"reliable": reliable, "transient_local": transient_local}
    commands, states = [low_command(number) for number in range(20)], [low_state(number) for number in range(20)]

    async def main() -> None:
        async with (
            open_participant(DOMAIN, "127.0.0.1" if multicast else OURS, (), multicast) as participant,
            cyclone(multicast, reads=[COMMAND, REQUEST], writes=[STATE, RESPONSE], **qos) as robot,
        ):
            ours = Robotics(participant, [COMMAND, REQUEST], [STATE, RESPONSE], **qos)
            await ours.matched(participant)
            await robot.until_it_has_matched(STATE, RESPONSE)
            for command, state in zip(commands, states, strict=True):
                assert ours.writers[COMMAND].write(HEAD + command) == 1
                await robot.do(do="write", topic=STATE, image=state_image(state).hex())
            ours.writers[REQUEST].write(request(7, 1001, "odd"))
            await robot.until(lambda _: len(robot.images(COMMAND)) == 20 and ours.heard[RESPONSE])
            await robot.until(lambda _: len(ours.heard[STATE]) == 20)
            assert robot.images(COMMAND) == [command_image(command).hex() for command in commands]
            assert ours.heard[STATE] == [HEAD + state for state in states]
            assert [parsed(payload) for payload in ours.heard[RESPONSE]] == [(7, 1001, 7, "ODD")]
            assert participant.counters.malformed == 0

    run(main)


@pytest.mark.parametrize("reliable", [False, True])
def test_our_robot_and_a_cyclone_driver(reliable: bool) -> None:
    """The reverse, as our twins do."""
    commands, states = [low_command(number) for number in range(20)], [low_state(number) for number in range(20)]

    async def main() -> None:
        async with (
            open_participant(DOMAIN, OURS, ("127.0.0.1",), False) as participant,
            cyclone(
                False,
                reads=[STATE, RESPONSE],
                writes=[COMMAND, REQUEST],
                reliable=reliable,
                transient_local=False,
            ) as driver,
        ):
            # A robot offers reliable in any case. It accepts commands as they are offered.
            ours = Robotics(participant, [STATE, RESPONSE], [], reliable=True)
            requested = Robotics(participant, [], [COMMAND, REQUEST], reliable=reliable)
            await ours.matched(participant)
            await requested.matched(participant)
            await driver.until_it_has_matched(COMMAND, REQUEST)
            for command, state in zip(commands, states, strict=True):
                assert ours.writers[STATE].write(HEAD + state) == 1
                await driver.do(do="write", topic=COMMAND, image=command_image(command).hex())
            await driver.do(do="request", id=9, api=7101, text='{"data":1}')
            await driver.until(lambda _: len(requested.heard[COMMAND]) == 20 and requested.heard[REQUEST])
            ours.writers[RESPONSE].write(response(9, 7101, 0, "ok"))
            (reported,) = await driver.until(lambda said: [line for line in said if line.get("topic") == RESPONSE])
            await driver.until(lambda _: len(driver.images(STATE)) == 20)
            assert requested.heard[COMMAND] == [HEAD + command for command in commands]
            assert requested.heard[REQUEST] == [request(9, 7101, '{"data":1}')]
            assert driver.images(STATE) == [state_image(state).hex() for state in states]
            assert reported == {"topic": RESPONSE, "id": 9, "api": 7101, "code": 0, "text": "ok"}

    run(main)


def test_a_reliable_reader_does_not_match_our_best_effort_writer() -> None:
    """Both sides find that they do not match; ours gives the reason."""

    async def main() -> None:
        async with (
            open_participant(DOMAIN, OURS, (), False) as participant,
            cyclone(False, reads=[COMMAND], writes=[STATE], reliable=True, transient_local=False) as robot,
        ):
            command = participant.writer(COMMAND, TOPICS[COMMAND])
            state = participant.reader(STATE, TOPICS[STATE], lambda *_: None, reliable=True)
            await participant.wait_matched(state)
            await robot.until(lambda _: command.mismatch)
            assert command.matched == 0
            assert "best effort" in command.mismatch

    run(main)


def test_a_peer_that_ends_in_order_is_forgotten_at_once() -> None:
    async def main() -> None:
        async with open_participant(DOMAIN, OURS, (), False) as participant:
            state = participant.reader(STATE, TOPICS[STATE], lambda *_: None)
            async with cyclone(False, reads=[], writes=[STATE], reliable=False, transient_local=False):
                await participant.wait_matched(state)
            # It has ended in order, so no lease has to expire (Cyclone's is 10 s).
            with trio.fail_after(5.0):
                while participant.peers:  # noqa: ASYNC110
                    await trio.sleep(0.01)
            assert state.matched == 0

    run(main)

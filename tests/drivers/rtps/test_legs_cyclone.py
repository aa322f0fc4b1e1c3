"""Test the G1's twin with CycloneDDS, as the vendor uses it: each side understands the other."""

from __future__ import annotations

import struct
from pathlib import Path

import trio

from strands_actors.drivers.unitree.protocol import CommandCodec
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.testing.twin import Twin

from .test_cyclone import COMMAND, CONFIG, STATE, command_image, cyclone, run

MODEL = model_of("unitree_g1")
STATE_IMAGE_MOTOR = 72
"""Offset of the motors in the C struct of a LowState. Each has 56 bytes, with q at the fourth."""


def knee_of(image: str) -> float:
    at = STATE_IMAGE_MOTOR + 56 * MODEL.axes.index("left_knee")
    value: float = struct.unpack_from("<f", bytes.fromhex(image), at + 4)[0]
    return value


def command(knee_rad: float, home: tuple[float, ...]) -> bytes:
    knee, zero = MODEL.axes.index("left_knee"), (0.0,) * 29
    q = (*home[:knee], knee_rad, *home[knee + 1 :])
    return CommandCodec(MODEL).encode(5, (*q, *zero, *zero, *(100.0,) * 29, *(2.0,) * 29))


def test_a_cyclone_client_bends_the_knee_of_the_twin(tmp_path: Path) -> None:
    async def main() -> None:
        with Twin("unitree_g1", tmp_path) as twin:
            peers = f'<Peers><Peer address="{twin.port.partition(":")[0]}"/></Peers>'
            config = CONFIG.format(multicast="false", peers=peers)
            async with cyclone(
                False,
                domain=0,
                config=config,
                reads=[STATE],
                writes=[COMMAND],
                reliable=False,
                transient_local=False,
            ) as client:
                await client.until(lambda _: client.images(STATE))
                assert abs(knee_of(client.images(STATE)[-1])) < 0.05
                await client.until_it_has_matched(COMMAND)
                frame = command(0.5, (0.0,) * 29)
                wrong = bytearray(frame)
                wrong[-1] ^= 1
                await client.do(do="write", topic=COMMAND, image=command_image(bytes(wrong)).hex())
                await client.do(do="write", topic=COMMAND, image=command_image(frame).hex())
                await client.until(lambda _: client.images(STATE) and knee_of(client.images(STATE)[-1]) > 0.3)
            assert [entry.data for entry in twin.log.host("setpoint")] == [frame]
            assert [entry.data for entry in twin.log.host("garbled")] == [bytes(wrong)]  # logged, not carried out

    run(main)


def test_the_twin_sends_at_its_rate(tmp_path: Path) -> None:
    async def main() -> None:
        with Twin("unitree_g1", tmp_path) as twin:
            peers = f'<Peers><Peer address="{twin.port.partition(":")[0]}"/></Peers>'
            config = CONFIG.format(multicast="false", peers=peers)
            async with cyclone(
                False, domain=0, config=config, reads=[STATE], writes=[], reliable=False, transient_local=False
            ) as client:
                await client.until(lambda _: client.images(STATE))
                client.said.clear()
                await trio.sleep(1.0)
                ticks = [struct.unpack_from("<I", bytes.fromhex(image), 12)[0] for image in client.images(STATE)]
            assert ticks == sorted(set(ticks))
            assert len(ticks) > 300  # of 500, for a busy machine

    run(main)

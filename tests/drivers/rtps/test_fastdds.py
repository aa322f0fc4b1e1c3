"""Test Fast DDS as the peer: Booster's unmodified client finds our participant, reads, calls and writes."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import trio

from strands_actors.drivers.common.rtps import open_participant

PATIENCE_S = 60.0  # its constructor alone takes seconds
DOMAIN = 150 + os.getpid() % 50  # two runs of these tests on one machine use different domains
DATA, RPC = "booster_interface::msg::dds_::", "booster_msgs::msg::dds_::"
HEAD = b"\x00\x01\x00\x00"
MOTORS = 23
CHANGE_MODE, GET_MODE = 2000, 2017
WALKING = 2


def low_state(positions: list[float]) -> bytes:
    motors = struct.pack("<I", MOTORS) + b"".join(
        struct.pack("<B3x4fB3xI2I", 1, position, 0, 0, 0, 30, 0, 0, 0) for position in positions
    )
    return HEAD + struct.pack("<9f", *range(9)) + motors + motors


def text(value: str) -> bytes:
    characters = value.encode() + b"\x00"
    return struct.pack("<I", len(characters)) + characters + bytes(-len(characters) % 4)


def texts(payload: bytes) -> list[str]:
    found, at = [], 4
    for _ in range(3):
        (length,) = struct.unpack_from("<I", payload, at)
        found.append(payload[at + 4 : at + 3 + length].decode())
        at += 4 + length + -length % 4
    return found


class Robot:
    """The parts of a T1 that its client needs: modes, and a list of the received commands."""

    def __init__(self) -> None:
        self.mode = 1
        self.commands: list[tuple[int, int, float]] = []

    def on_command(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        kind, count = struct.unpack_from("<II", payload, 4)
        (position,) = struct.unpack_from("<f", payload, 4 + 12 + 28 * 3)
        self.commands.append((kind, count, position))

    def answer(self, payload: bytes) -> bytes:
        uuid, header, body = texts(payload)
        api = json.loads(header)["api_id"]
        if api == CHANGE_MODE:
            self.mode = json.loads(body)["mode"]
        said = json.dumps({"mode": self.mode}) if api == GET_MODE else ""
        return HEAD + text(uuid) + text(json.dumps({"status": 0})) + text(said)


def test_boosters_client_works_with_our_participant() -> None:
    said: list[dict[str, Any]] = []
    robot = Robot()

    async def main() -> None:
        async with open_participant(DOMAIN) as participant, trio.open_nursery() as nursery:
            responses = participant.writer("rt/LocoApiTopicResp", f"{RPC}RpcRespMsg_", reliable=True)
            participant.reader(
                "rt/LocoApiTopicReq",
                f"{RPC}RpcReqMsg_",
                lambda payload, writer, t_ns: responses.write(robot.answer(bytes(payload))),
                reliable=True,
            )
            participant.reader("rt/joint_ctrl", f"{DATA}LowCmd_", robot.on_command)
            states = participant.writer("rt/low_state", f"{DATA}LowState_", reliable=True)
            participant.writer("rt/fall_down", f"{DATA}FallDownState_", reliable=True)

            async def stream() -> None:
                await participant.wait_matched(states)
                number = 0
                while True:
                    number += 1
                    states.write(low_state([number / 256 + motor for motor in range(MOTORS)]))
                    await trio.sleep(0.005)

            command = [sys.executable, str(Path(__file__).parent / "fastdds_peer.py"), str(DOMAIN)]
            process = await trio.lowlevel.open_process(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
            )
            nursery.start_soon(stream)
            try:
                rest = b""
                assert process.stdout is not None and process.stdin is not None
                async for read in process.stdout:
                    *lines, rest = (rest + read).split(b"\n")
                    # Its library writes to standard output, too.
                    said.extend(json.loads(line) for line in lines if line.startswith(b'{"'))
                    if {"written": 20} in said:
                        break
                while len(robot.commands) < 20:  # noqa: ASYNC110
                    await trio.sleep(0.005)
                await process.stdin.aclose()
                assert await process.wait() == 0
            finally:
                process.kill()
                nursery.cancel_scope.cancel()
            assert participant.counters.malformed == 0

    async def bounded() -> None:
        with trio.fail_after(PATIENCE_S):
            await main()

    trio.run(bounded)
    heard, mode, _ = said
    first = round(heard["states"][0][0] * 256)
    assert heard["states"] == [
        [(first + number) / 256 + motor for motor in range(MOTORS)] for number in range(len(heard["states"]))
    ]
    assert mode == {"mode": WALKING}
    assert robot.commands == [(1, MOTORS, number / 16) for number in range(20)]

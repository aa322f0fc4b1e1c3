"""Test standard Modbus at the control port of the twin, with the registers of the vendor's manual."""

from __future__ import annotations

import math
import struct

import pytest

from strands_actors.drivers.common.twin import Faults
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.twin import ControlSession, controller_of
from strands_actors.drivers.xarm.twin.modbus import ILLEGAL_ADDRESS, ILLEGAL_DATA, ILLEGAL_FUNCTION, Modbus


class Client:
    def __init__(self) -> None:
        self.controller = controller_of("xarm7", now_s=lambda: 100.0)
        self._session = ControlSession(self.controller, Faults())

    def ask(self, function: int, data: bytes) -> bytes:
        """Return function and data of the reply."""
        request = p.frame(7, bytes((1, function)) + data, p.STANDARD_MODBUS)
        (exchange,) = self._session.receive(request, None)
        number, protocol, length, unit = struct.unpack_from(">HHHB", exchange.replies[0].data)
        assert (number, protocol, unit) == (7, p.STANDARD_MODBUS, 1)
        assert length == len(exchange.replies[0].data) - 6
        return exchange.replies[0].data[7:]

    def words(self, function: int, address: int, count: int) -> tuple[int, ...]:
        return struct.unpack(f">{count}h", self.ask(function, struct.pack(">HH", address, count))[2:])


def test_it_reads_pose_and_angles_ten_times_in_millimetres_and_degrees() -> None:
    client = Client()
    pose = client.controller.pose()
    x, y, z, roll, *_ = client.words(4, 0x40, 9)
    assert (x, y, z) == tuple(round(10 * mm) for mm in pose[:3])
    assert roll == round(10 * math.degrees(pose[3]))
    angles = client.words(4, 0x59, 7)
    assert angles == tuple(round(10 * math.degrees(rad)) for rad in client.controller.plant.position_rad)


def test_it_writes_outputs_mode_and_state() -> None:
    client = Client()
    assert client.ask(15, bytes.fromhex("0000 0008 01 b5".replace(" ", ""))) == bytes.fromhex("0f00000008")
    assert client.controller.devices.outputs == 0xB5
    assert client.ask(1, bytes.fromhex("00000010"))[1:] == b"\2\xb5\0"
    assert client.ask(6, bytes.fromhex("00200001")) == bytes.fromhex("0600200001")
    assert client.controller.mode == 1 and client.words(3, 0x20, 1) == (1,)
    client.ask(5, bytes.fromhex("008eff00"))
    assert client.ask(1, bytes.fromhex("008e0001"))[2] == 1


@pytest.mark.parametrize(
    ("function", "data", "exception"),
    [
        (7, "00000001", ILLEGAL_FUNCTION),
        (3, "00400001", ILLEGAL_ADDRESS),
        (5, "0087ff00", ILLEGAL_ADDRESS),
        (1, "00000000", ILLEGAL_DATA),
        (3, "00", ILLEGAL_DATA),
        (16, "01000002 02 0005", ILLEGAL_DATA),
    ],
)
def test_what_is_not_there_gets_the_exception_of_the_manual(function: int, data: str, exception: int) -> None:
    assert Client().ask(function, bytes.fromhex(data)) == bytes((function | 0x80, exception))


def test_the_shortest_requests_are_answered() -> None:
    modbus = Modbus(controller_of("xarm7", now_s=lambda: 100.0))
    assert modbus.answer(b"\1") == bytes((1, 0x80, ILLEGAL_FUNCTION))

"""The devices of the arm: what their configuration services return.

The numbers of the actuators are those of the vendor's examples. The other numbers and all texts are [assumed].
"""

from __future__ import annotations

from typing import NamedTuple

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova.protocol import JOINTS, SubError

from .errors import CallFailed
from .functions import Function

BASE, BIG_ACTUATOR, SMALL_ACTUATOR, INTERCONNECT, GRIPPER = 1, 3, 4, 5, 6
"""Types of devices."""

BIG_JOINTS = 4

MODEL_GEN3, BASE_FIXED, NO_GRIPPER, ROBOTIQ_2F_85, NOT_INSTALLED = 1, 2, 1, 3, 1
INTERFACE_GEN3, NOT_APPLICABLE, SPHERICAL_WRIST, SPOKE_BRAKE = 2, 1, 2, 2
"""Values of ``CompleteProductConfiguration``."""


class Device(NamedTuple):
    kind: int
    identifier: int


class Devices:
    def __init__(self, has_gripper: bool) -> None:
        self._has_gripper = has_gripper
        actuators = [
            Device(BIG_ACTUATOR if joint < BIG_JOINTS else SMALL_ACTUATOR, joint + 1) for joint in range(JOINTS)
        ]
        self._devices = [Device(BASE, 0), *actuators, Device(INTERCONNECT, JOINTS + 2)]
        if has_gripper:
            self._devices.append(Device(GRIPPER, JOINTS + 3))

    def read_all(self) -> bytes:
        """Return ``DeviceHandles``."""
        return b"".join(
            pb.bytes_field(
                1, pb.varint_field(1, each.kind) + pb.varint_field(2, each.identifier) + pb.varint_field(3, order)
            )
            for order, each in enumerate(self._devices)
        )

    def read(self, function: int, identifier: int) -> bytes:
        """Return the answer of a device to a function of the device configuration."""
        device = next((each for each in self._devices if each.identifier == identifier), None)
        if device is None:
            raise CallFailed(SubError.INVALID_DEVICE, f"no device has the number {identifier}")
        match function:
            case Function.GET_DEVICE_TYPE:
                return pb.varint_field(1, device.kind)
            case Function.GET_FIRMWARE_VERSION | Function.GET_BOOTLOADER_VERSION:
                return pb.varint_field(1, 0x02060000)
            case Function.GET_MAC_ADDRESS:
                return pb.bytes_field(1, bytes((0x02, 0, 0, 0, 0, identifier)))
            case Function.GET_PART_NUMBER_REVISION:
                return pb.bytes_field(1, b"0001")
        return pb.bytes_field(1, f"TWIN-{identifier:02}".encode())

    @staticmethod
    def joint(identifier: int) -> int:
        """Return the index of the joint of an actuator. Raise ``CallFailed`` for another device."""
        if not 1 <= identifier <= JOINTS:
            raise CallFailed(SubError.INVALID_DEVICE, f"no actuator has the number {identifier}")
        return identifier - 1

    def product(self) -> bytes:
        """Return ``CompleteProductConfiguration``."""
        numbers = {
            2: MODEL_GEN3,
            6: JOINTS,
            7: BASE_FIXED,
            8: ROBOTIQ_2F_85 if self._has_gripper else NO_GRIPPER,
            9: NOT_INSTALLED,
            10: INTERFACE_GEN3,
            11: NOT_APPLICABLE,
            12: SPHERICAL_WRIST,
            13: SPOKE_BRAKE,
        }
        return pb.bytes_field(1, b"TWIN") + b"".join(
            pb.varint_field(number, value) for number, value in numbers.items()
        )

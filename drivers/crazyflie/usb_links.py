"""Links over USB, with pyusb: a Crazyradio dongle, and a Crazyflie's own USB port. They were never used on
hardware.

This module is loaded only in a process that may be killed, because a call of libusb cannot be cancelled. Each
packet is one transaction, in a thread and with a deadline. A sender waits until the running transaction ends,
and checks only then whether its packet may still be sent. A drone on a radio sends only answers, so ``read``
polls it a hundred times a second with empty packets. These are not setpoints, and the firmware's watchdog
ignores them.
"""

from __future__ import annotations

from collections import deque
from typing import Any, ClassVar

import trio

from strands_actors.contract.wire import Permit, WireDown
from strands_actors.drivers.common.kit.sdk import SdkCalls, load_sdk

from .config import Endpoint
from .links import Link
from .protocol import NULL

INSTALL = "Install it: pip install 'strands-actors[crazyflie]'"
NO_LIBUSB = "libusb is not installed. Install it: apt-get install libusb-1.0-0"

RADIO_ID, DRONE_ID = (0x1915, 0x7777), (0x0483, 0x5740)
"""USB ids of vendor and product: Crazyradio, Crazyradio PA and 2.0; a Crazyflie."""
SET_CHANNEL, SET_ADDRESS, SET_RATE, SET_POWER, SET_RETRY_DELAY, SET_RETRIES, ACK_ENABLE = 1, 2, 3, 4, 5, 6, 0x10
"""Vendor requests of the dongle. These and the following values are from Bitcraze's documentation of the
Crazyradio's USB protocol."""
FULL_POWER = 3
RETRY_BYTES = 0x80 | 32
"""Wait for an answer of 32 bytes before a repetition."""
RETRIES = 3
CRTP_BY_USB = 1
"""Vendor request of a drone. Value 1 means CRTP over USB from now on."""
VENDOR_OUT = 0x40
OUT, IN = 0x01, 0x81
SIZE = 64

TRANSFER_MS = 20
CALL_S = 0.15
"""Longest time for one transaction: two transfers, on a busy machine."""
OPEN_S = 3.0
POLL_S = 0.01


class UsbLink(Link):
    """A link over USB: a radio dongle (``is_radio``) or the drone's own port. A radio answers each packet with
    an acknowledgement, which may contain data."""

    prompt: ClassVar[bool] = False  # type: ignore[misc]  # an instance attribute elsewhere

    def __init__(self, device: Any, calls: SdkCalls, errors: type[Exception], is_radio: bool, name: str) -> None:
        self._device = device
        self._calls = calls
        self._errors = errors
        self._is_radio = is_radio
        self._turn = trio.Lock()
        self._waiting: deque[bytes] = deque()
        self._news = trio.Event()
        self.name = name
        self.lost = 0  # packets that the radio did not deliver

    async def write(self, packet: bytes, permit: Permit | None = None) -> None:
        async with self._turn:
            if permit is not None:
                permit.check()
            received = await self._calls.call("a transfer", CALL_S, self._transfer, packet)
        if isinstance(received, str):
            raise WireDown(f"{self.name}: the USB device is gone ({received}). Plug it in again")
        self._take(received)

    def _transfer(self, packet: bytes) -> bytes | str:
        """Send a packet and return the device's answer, or a text if the device is gone. Runs in a thread."""
        try:
            if packet:
                self._device.write(OUT, packet, TRANSFER_MS)
            return bytes(self._device.read(IN, SIZE, TRANSFER_MS))
        except self._errors as error:
            if getattr(error, "errno", None) in _TIMEOUTS:
                return b""
            return str(error)

    def _take(self, received: bytes) -> None:
        if self._is_radio:
            status, received = received[:1], received[1:]
            if not status or not status[0] & 1:
                self.lost += 1
                return
        if received and received[0] & 0xF3 != 0xF3:
            self._waiting.append(received)
            self._news.set()
            self._news = trio.Event()

    async def read(self) -> bytes:
        while not self._waiting:
            await self._poll()
            if not self._waiting:
                await trio.sleep(POLL_S)
        return self._waiting.popleft()

    def read_waiting(self) -> bytes | None:
        return self._waiting.popleft() if self._waiting else None

    async def _poll(self) -> None:
        await self.write(NULL if self._is_radio else b"")

    def close(self) -> None:
        self._calls.spent = self._calls.spent or f"{self.name}: closed"
        load_sdk("usb.util", INSTALL).dispose_resources(self._device)


_TIMEOUTS = (110, 60)
"""ETIMEDOUT, on Linux and on macOS."""


def load_usb() -> None:
    """Load pyusb and libusb, for a process that must not do so only during a stop. Raise ``WireDown``."""
    core = load_sdk("usb.core", INSTALL)
    load_sdk("usb.util", INSTALL)
    vendor, product = RADIO_ID
    try:
        # The first search loads libusb.
        core.find(find_all=True, idVendor=vendor, idProduct=product)
    except core.NoBackendError:
        raise WireDown(NO_LIBUSB) from None


async def open_usb_link(endpoint: Endpoint) -> Link:
    """Open a radio dongle or a drone on USB, without sending a packet. Raise ``WireDown``."""
    core = load_sdk("usb.core", INSTALL)
    name = f"radio://{endpoint.number}" if endpoint.kind == "radio" else f"usb://{endpoint.number}"
    calls = SdkCalls("pyusb", (OSError,))
    device = await calls.open("opening", OPEN_S, _open, core, endpoint)
    if isinstance(device, str):
        raise WireDown(f"{name}: {device}")
    return UsbLink(device, calls, core.USBError, endpoint.kind == "radio", name)


def _open(core: Any, endpoint: Endpoint) -> Any:
    """Return the configured USB device, or a text with the reason of a failure. Runs in a thread."""
    vendor, product = RADIO_ID if endpoint.kind == "radio" else DRONE_ID
    device_name = "Crazyradio" if endpoint.kind == "radio" else "Crazyflie"
    try:
        devices = list(core.find(find_all=True, idVendor=vendor, idProduct=product))
        if endpoint.number >= len(devices):
            return f"USB has {len(devices)} of {device_name}. Plug the device in, or give another number"
        device = devices[endpoint.number]
        device.set_configuration(1)
        if endpoint.kind == "usb":
            device.ctrl_transfer(VENDOR_OUT, CRTP_BY_USB, 1, 1, ())
            return device
        settings: tuple[tuple[int, int, bytes], ...] = (
            (SET_RATE, endpoint.rate, b""),
            (SET_CHANNEL, endpoint.channel, b""),
            (SET_ADDRESS, 0, endpoint.address),
            (SET_POWER, FULL_POWER, b""),
            (SET_RETRY_DELAY, RETRY_BYTES, b""),
            (SET_RETRIES, RETRIES, b""),
            (ACK_ENABLE, 1, b""),
        )
        for request, value, data in settings:
            device.ctrl_transfer(VENDOR_OUT, request, value, 0, data)
        return device
    except core.NoBackendError:
        return NO_LIBUSB
    except core.USBError as error:
        return f"cannot be opened ({error}). Check which program has it open, and the udev rules of USB devices"

"""Devices with pyusb's interface: transfers that wait, errors with a number."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
from collections.abc import Iterator
from typing import Any

SETTINGS = {1: "channel", 2: "address", 3: "rate", 4: "power", 5: "retry delay", 6: "retries", 0x10: "acknowledge"}
NULL = b"\xff"
WAIT_S = 0.002
"""Time for the drone's answer to a packet."""


class USBError(OSError):
    pass


class USBTimeoutError(USBError):
    pass


class NoBackendError(ValueError):
    pass


class Device:
    """A device that one process has at a time, like the kernel's claim on an interface."""

    def __init__(self, config: dict[str, Any], kind: str) -> None:
        self._config = config
        self._kind = kind
        self._claim = open(config["events"], "a")  # noqa: SIM115  # open while the device is claimed
        self._sock: socket.socket | None = None
        self._answers: list[bytes] = []
        self.settings: dict[str, Any] = {}

    def set_configuration(self, number: int) -> None:
        try:
            fcntl.flock(self._claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise USBError(errno.EBUSY, "Resource busy") from None
        host, _, port = self._config["twin"].rpartition(":")
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sock.connect((host, int(port)))
        self._sock.settimeout(WAIT_S)
        self._note("claimed", os.getpid())

    def ctrl_transfer(self, kind: int, request: int, value: int, index: int, data: bytes) -> int:
        assert kind == 0x40
        name = SETTINGS[request] if self._kind == "radio" else f"request {request}"
        self._note(name, bytes(data).hex() if data else value)
        return len(data)

    def write(self, endpoint: int, data: bytes, timeout: int) -> int:
        assert endpoint == 1 and 0 < len(data) <= 32 and self._sock is not None
        self._check()
        try:
            if data != NULL:  # it does not go beyond the drone's radio
                self._sock.send(data)
            self._answers.append(self._hear())
        except OSError:
            self._answers.append(b"")  # no acknowledgement
        return len(data)

    def read(self, endpoint: int, size: int, timeout: int) -> bytes:
        assert endpoint == 0x81 and self._sock is not None
        self._check()
        if self._kind == "radio":
            said = self._answers.pop(0) if self._answers else b""
            return b"\x01" + said if said else b"\x01"
        said = self._answers.pop(0) if self._answers else self._hear()
        if not said:
            raise USBTimeoutError(errno.ETIMEDOUT, "Operation timed out")
        return said

    def _hear(self) -> bytes:
        assert self._sock is not None
        try:
            return self._sock.recv(32)
        except (TimeoutError, ConnectionRefusedError):
            return b""

    def _check(self) -> None:
        if os.path.exists(self._config["events"] + ".unplugged"):
            raise USBError(errno.ENODEV, "No such device (it may have been disconnected)")

    def _note(self, what: str, value: object) -> None:
        self._claim.write(json.dumps([what, value]) + "\n")
        self._claim.flush()


def find(find_all: bool = False, idVendor: int = 0, idProduct: int = 0) -> Iterator[Device]:
    assert find_all
    config = json.loads(os.environ["CRAZYFLIE_STANDIN"])
    kinds = {(0x1915, 0x7777): "radio", (0x0483, 0x5740): "usb"}
    kind = kinds[idVendor, idProduct]
    return iter([Device(config, kind)] if kind in config["devices"] else [])

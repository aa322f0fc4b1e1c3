"""The call that releases a device."""

from __future__ import annotations

from .core import Device


def dispose_resources(device: Device) -> None:
    device._claim.close()
    if device._sock is not None:
        device._sock.close()

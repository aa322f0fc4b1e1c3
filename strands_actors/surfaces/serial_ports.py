"""List the serial devices that are plugged into this computer."""

from __future__ import annotations

import os
from collections.abc import Sequence
from glob import glob

BY_ID = "/dev/serial/by-id/*"


def serial_ports(also: Sequence[str] = ()) -> dict[str, str]:
    """Return the serial devices by path, each with a text: USB ids, product and permanent path.

    Args:
        also: Further device paths, which may contain wildcards.
    """
    from serial.tools import list_ports

    stay = {os.path.realpath(link): link for link in glob(BY_ID)}
    ports = {}
    for port in sorted(list_ports.comports()):
        usb_id = f"{port.vid:04X}:{port.pid:04X}" if port.vid is not None and port.pid is not None else ""
        ports[port.device] = " ".join(
            part for part in (usb_id, port.product or "", stay.get(port.device, "")) if part
        )
    return ports | {path: "" for pattern in also for path in sorted(glob(pattern))}

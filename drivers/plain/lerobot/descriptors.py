"""Find the descriptors of serial devices that a library has opened in this process, by the device.

The library need not show its descriptor. LeRobot's buses once had it as an attribute of a vendor's object, and no
longer do. The port may also be locked, so that opening it a second time fails.
"""

from __future__ import annotations

import os
import select
import stat
from collections.abc import Mapping
from typing import Any

OPEN_FILES = ("/proc/self/fd", "/dev/fd")
"""The folders that list the descriptors of the process that reads them: Linux, and systems without ``/proc``."""


def devices_in(options: Any) -> frozenset[int]:
    """Return the numbers of the character devices that a robot's options name, also in nested options.

    Args:
        options: The options: mappings, and values of any type.
    """
    if isinstance(options, Mapping):
        return frozenset[int]().union(*map(devices_in, options.values()))
    return _device(options) if isinstance(options, str | os.PathLike) else frozenset()


def descriptors_of(devices: frozenset[int]) -> list[int]:
    """Return a descriptor of this process for each device that is open here.

    A descriptor of a device that was unplugged and came back is no longer of use. It is returned only if there is
    no other.

    Args:
        devices: The numbers of character devices.
    """
    by_device: dict[int, int] = {}
    for descriptor in _open_descriptors():
        device = _open_device(descriptor)
        if device in devices and (device not in by_device or _has_hung_up(by_device[device])):
            by_device[device] = descriptor
    return list(by_device.values())


def _device(path: str | os.PathLike[str]) -> frozenset[int]:
    """Return the number of the device at a path, or at the end of a link; empty if no character device is there."""
    try:
        info = os.stat(path)
    except (OSError, ValueError):
        return frozenset()
    return frozenset({info.st_rdev}) if stat.S_ISCHR(info.st_mode) else frozenset()


def _open_descriptors() -> list[int]:
    folder = next(folder for folder in OPEN_FILES if os.path.isdir(folder))
    return sorted(int(name) for name in os.listdir(folder))


def _open_device(descriptor: int) -> int | None:
    """Return the number of the character device that a descriptor has open; None for anything else."""
    try:
        info = os.fstat(descriptor)
    except OSError:
        # The descriptor of the listing itself is closed by now.
        return None
    return info.st_rdev if stat.S_ISCHR(info.st_mode) else None


def _has_hung_up(descriptor: int) -> bool:
    poll = select.poll()
    poll.register(descriptor, 0)
    return any(events & (select.POLLHUP | select.POLLERR) for _, events in poll.poll(0))

"""Remember which USB adapter each robot had, so that swapped cables are noticed before anything is energised.

The serial number of the adapter of each robot is kept in a file that survives a reboot. A path such as
``/dev/ttyACM0`` is not an identity: it is given to the adapters in the order in which they are plugged in.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from strands_actors.caller.processes.run_directory import data_dir


class Adapter(NamedTuple):
    """A USB adapter that is plugged in.

    Attributes:
        device: Its device, without links: ``/dev/ttyACM0``.
        serial: Its serial number. Adapters without one are not listed.
    """

    device: str
    serial: str


def plugged_in() -> list[Adapter]:
    """Return the USB serial adapters of this computer that have a serial number."""
    from serial.tools import list_ports  # Only a computer with serial robots needs this import.

    ports: Iterable[Any] = list_ports.comports()
    return [Adapter(os.path.realpath(port.device), port.serial_number) for port in ports if port.serial_number]


def adapters_file() -> Path:
    """Return the file with the adapters of this user's robots."""
    return data_dir() / "adapters.json"


class Adapters:
    """The adapters of the robots of a host.

    Args:
        path: The file that remembers them.
        look: Returns the adapters that are plugged in.
    """

    def __init__(self, path: Path, look: Callable[[], list[Adapter]] = plugged_in) -> None:
        self._path = path
        self._look = look
        self.problem = ""
        """Why the file could not be read or written; empty if it could. Robots run without it."""
        self._serials = self._read()

    @property
    def serials(self) -> Mapping[str, str]:
        """Return the serial number of each robot's adapter, by the robot's name."""
        return self._serials

    def problem_of(self, robot: str, port: str, declared: str = "") -> str:
        """Return why the adapter at a port is not the robot's; empty if it is, or if this cannot be known.

        Args:
            robot: The robot's name.
            port: Its port.
            declared: The serial number in the file of the host. Without it, the remembered one counts.
        """
        expected = declared or self._serials.get(robot, "")
        adapters = self._look() if expected else []
        here = _adapter_at(port, adapters)
        if not expected or (here is None and not declared) or (here is not None and here.serial == expected):
            return ""
        own = next((adapter.device for adapter in adapters if adapter.serial == expected), "")
        where = (
            f"Its own adapter ({expected}) is at {own}"
            if own
            else f"Its own adapter ({expected}) is not plugged in"
        )
        remedy = "Swap the cables back, or give the right port"
        if not declared:
            remedy += ". If the adapter was replaced, start the host with --new-adapters"
        if here is None:
            return f"there is no USB adapter at {port}. {where}. {remedy}"
        owner = next(
            (name for name, serial in self._serials.items() if serial == here.serial and name != robot), ""
        )
        of_other = f", which belongs to {owner}" if owner else ""
        return f"{port} is another adapter ({here.serial}{of_other}): two cables may be swapped. {where}. {remedy}"

    def remember(self, robot: str, port: str) -> None:
        """Note the adapter with which a robot was opened."""
        here = _adapter_at(port, self._look()) if os.path.isabs(port) else None
        if here is None or self._serials.get(robot) == here.serial:
            return
        self._serials[robot] = here.serial
        try:
            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            draft = self._path.with_suffix(".tmp")
            draft.write_bytes(msgspec.json.format(msgspec.json.encode(self._serials)))
            draft.replace(self._path)
        except OSError as error:
            self.problem = f"{self._path} cannot be written: {error.strerror}"

    def forget(self) -> None:
        """Forget all adapters. The next start of each robot notes its adapter again."""
        self._serials = {}

    def _read(self) -> dict[str, str]:
        try:
            return msgspec.json.decode(self._path.read_bytes(), type=dict[str, str])
        except FileNotFoundError:
            return {}
        except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
            self.problem = f"{self._path} cannot be read: {error}"
            return {}


def _adapter_at(port: str, adapters: Iterable[Adapter]) -> Adapter | None:
    device = os.path.realpath(port)
    return next((adapter for adapter in adapters if adapter.device == device), None)

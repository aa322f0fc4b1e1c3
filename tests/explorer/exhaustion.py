"""Simulate the reserve of a process, and the requests that it makes to the system.

``Reserve`` is the product's class. While a simulated process runs, the object holds the state of that
process. This module answers its requests instead of the system.
"""

from __future__ import annotations

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.processes import reserve
from strands_actors.kernel.processes.reserve import RESERVE, Reserve

from .children import SimOs
from .resources import Resources
from .robot_model import Seam
from .world import Process, World


class _Memory:
    def __init__(self, resources: Resources, size: int) -> None:
        resources.map_bytes(size)
        self._resources = resources
        self._size = size

    def close(self) -> None:
        self._resources.freed_bytes += self._size


class _ReserveOs(SimOs):
    def close(self, fd: int) -> None:
        of_current(self._world).close_file()


def of_current(world: World) -> Resources:
    return world.current.resources


def open_file(process: Process, name: str) -> None:
    """Open a descriptor for a connection or port, as the product's code does.

    Raises:
        WireDown: The process has no descriptor left. If it could not carry out a stop either, it
            ends instead.
    """
    try:
        process.resources.open_file()
    except OSError as error:
        RESERVE.lacked(error)
        raise WireDown(f"{name}: cannot connect ({error.strerror})") from None


def enter(process: Process) -> None:
    """Load the reserve of this process."""
    RESERVE.__dict__ = process.resources.reserve


def seams_of(world: World) -> tuple[Seam, ...]:
    """Return the replacements that connect the reserve to the simulated system."""

    def lacks_thread() -> str:
        try:
            of_current(world).start_thread()
        except RuntimeError as error:
            return str(error)
        return ""

    def one_file() -> int:
        of_current(world).open_file()
        return -1

    return (
        (RESERVE, "__dict__", Reserve().__dict__),
        (reserve, "os", _ReserveOs(world)),
        (reserve, "_open_file", one_file),
        (reserve, "_address_space", lambda size: _Memory(of_current(world), size)),
        (reserve, "_lacks_thread", lacks_thread),
    )

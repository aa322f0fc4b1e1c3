"""The reserve of each simulated process (``kernel/processes/reserve.py``), which never lacks anything."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from strands_actors.kernel.health.processor import Life
from strands_actors.kernel.processes.reserve import Reserve

from .children import life_of

if TYPE_CHECKING:
    from .robot_model import Seam
    from .world import Process, World


class SimReserves:
    """The reserves of all processes of one world."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._stops: dict[Process, int] = {}

    def seams(self) -> tuple[Seam, ...]:
        """Return what replaces the methods of ``Reserve``, of which each process has one."""
        return (
            (Reserve, "begin", lambda *_: None),
            (Reserve, "check", lambda _: ""),
            (Reserve, "freed", lambda _: self._freed()),
            (Reserve, "is_freed", property(lambda _: self._stops.get(self._world.current, 0) > 0)),
            (Reserve, "lacked", lambda *_: None),
            (Reserve, "end_if_short", lambda _: None),
        )

    @contextlib.contextmanager
    def _freed(self) -> Iterator[None]:
        process = self._world.current
        self._stops[process] = self._stops.get(process, 0) + 1
        try:
            yield
        finally:
            self._stops[process] -= 1


class SimStat:
    """Stands in for ``StatFile``."""

    def __init__(self, world: World, pid: int) -> None:
        self._world = world
        self._pid = pid

    def life(self) -> Life:
        return life_of(self._world, self._pid)

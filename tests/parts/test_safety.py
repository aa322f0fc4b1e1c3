"""SAF: what one part suffers, or the processes that command all parts, stops every part. Read on both wires."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from .cells import Cell, is_limp, ok, opened, setpoints_after_limp, until


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with opened(tmp_path_factory.mktemp("cell")) as cell:
        yield cell


def both_stop(cell: Cell, since_ns: int) -> None:
    for part, log in cell.logs.items():
        until(lambda log=log: is_limp(log, since_ns), f"{part}: {log.story(since_ns)}")  # type: ignore[misc]
    until(lambda: ok(cell.robot.get_status())["state"] not in ("armed", "holding", "stopping"), "still armed")
    for log in cell.logs.values():
        assert setpoints_after_limp(log, since_ns) == 0, log.story(since_ns)


@pytest.mark.parametrize(
    "roles",
    [("left/wire",), ("right/root",), ("wire",), ("left/wire", "wire"), ("wire", "root")],
    ids=lambda roles: "+".join(roles),
)
def test_a_killed_process_stops_every_part(cell: Cell, roles: tuple[str, ...]) -> None:
    cell.move()
    both_stop(cell, cell.kill(*roles))


@pytest.mark.parametrize("role", ["left/wire", "wire"])
def test_a_frozen_process_stops_every_part(cell: Cell, role: str) -> None:
    cell.move()
    both_stop(cell, cell.kill(role, how=signal.SIGSTOP))

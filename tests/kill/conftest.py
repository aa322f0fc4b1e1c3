"""The benches of the tests that break processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from strands_actors.testing import Bench

BenchOf = Callable[[str], Bench]


@pytest.fixture(scope="module")
def bench_of() -> Iterator[BenchOf]:
    """Return the bench of a column. Cells are ordered by column, and a bench ends when the next begins."""
    benches: dict[str, Bench] = {}

    def end() -> None:
        for column in list(benches):
            benches.pop(column).__exit__(None, None, None)

    def of(column: str) -> Bench:
        if column not in benches:
            end()
            benches[column] = Bench(column).__enter__()
        return benches[column]

    yield of
    end()

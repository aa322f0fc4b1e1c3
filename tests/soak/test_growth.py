"""The soak test finds files, threads and memory that grow, and ignores short peaks."""

from __future__ import annotations

import os

from .growth import Sample, descendants, growth_of, sample

HALF_AN_HOUR = [20.0 * at for at in range(60)]


def test_growth_of_two_megabytes_an_hour_is_found() -> None:
    noisy = [Sample(t_s, 20, 3, round(30_000 + 2048 * t_s / 3600 + 300 * (at % 5))) for at, t_s in _numbered()]
    (found,) = growth_of(noisy)
    assert found.startswith("memory: ")


def test_a_short_peak_and_half_a_megabyte_an_hour_do_not_count_as_growth() -> None:
    noisy = [Sample(t_s, 20, 3, round(30_000 + 512 * t_s / 3600 + 4000 * (at % 7 == 0))) for at, t_s in _numbered()]
    assert growth_of(noisy) == []


def test_a_descriptor_that_stays_and_a_thread_that_stays_are_found() -> None:
    leaking = [Sample(t_s, 20 + (at > 40), 3 + (at > 50), 30_000) for at, t_s in _numbered()]
    steady = [each._replace(files=20 + at // 20, threads=3 + at // 25) for at, each in enumerate(leaking)]
    assert [line.partition(":")[0] for line in growth_of(steady)] == ["files", "threads"]


def test_descriptors_that_come_and_go_are_no_growth() -> None:
    busy = [Sample(t_s, 20 + at % 3, 3, 30_000) for at, t_s in _numbered()]
    assert growth_of(busy) == []


def test_this_process_is_read() -> None:
    own = sample(os.getpid(), 0.0)
    assert own is not None
    assert own.files > 2 and own.memory_kb > 1000
    assert os.getpid() in descendants(os.getppid())
    assert sample(2**22 + 1, 0.0) is None


def _numbered() -> list[tuple[int, float]]:
    return list(enumerate(HALF_AN_HOUR))

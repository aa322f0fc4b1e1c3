"""A robot's adapter is remembered, so that swapped cables are noticed and named."""

from __future__ import annotations

from pathlib import Path

import pytest

from strands_actors.surfaces.host.adapters import Adapter, Adapters

LEFT, RIGHT = Adapter("/dev/ttyACM0", "A1"), Adapter("/dev/ttyACM1", "B2")


@pytest.fixture
def known(tmp_path: Path) -> Path:
    path = tmp_path / "data" / "adapters.json"
    adapters = Adapters(path, lambda: [LEFT, RIGHT])
    adapters.remember("left", LEFT.device)
    adapters.remember("right", RIGHT.device)
    return path


def test_the_same_adapters_have_no_problem(known: Path) -> None:
    adapters = Adapters(known, lambda: [LEFT, RIGHT])
    assert adapters.problem_of("left", LEFT.device) == ""
    assert adapters.problem_of("new", "/dev/ttyACM7") == ""


def test_swapped_cables_are_named(known: Path) -> None:
    swapped = [Adapter(LEFT.device, RIGHT.serial), Adapter(RIGHT.device, LEFT.serial)]
    adapters = Adapters(known, lambda: swapped)
    problem = adapters.problem_of("left", LEFT.device)
    for part in (
        "/dev/ttyACM0 is another adapter (B2, which belongs to right)",
        "swapped",
        "(A1) is at /dev/ttyACM1",
    ):
        assert part in problem
    assert "belongs to left" in adapters.problem_of("right", RIGHT.device)


def test_a_link_to_the_device_is_the_device(known: Path, tmp_path: Path) -> None:
    link = tmp_path / "left"
    link.symlink_to(RIGHT.device)
    assert "another adapter" in Adapters(known, lambda: [LEFT, RIGHT]).problem_of("left", str(link))


def test_a_replaced_adapter_is_accepted_on_request(known: Path) -> None:
    new = Adapter(LEFT.device, "C3")
    adapters = Adapters(known, lambda: [new, RIGHT])
    assert "--new-adapters" in adapters.problem_of("left", LEFT.device)
    adapters.forget()
    assert adapters.problem_of("left", LEFT.device) == ""
    adapters.remember("left", LEFT.device)
    assert Adapters(known, lambda: [new]).serials["left"] == "C3"


def test_an_adapter_without_serial_number_is_not_compared(known: Path) -> None:
    adapters = Adapters(known, list)
    assert adapters.problem_of("left", LEFT.device) == ""
    assert "no USB adapter at /dev/ttyACM0" in adapters.problem_of("left", LEFT.device, declared="A1")


def test_the_serial_number_in_the_file_counts_more_than_memory(known: Path) -> None:
    adapters = Adapters(known, lambda: [LEFT, RIGHT])
    problem = adapters.problem_of("left", LEFT.device, declared="D4")
    assert "(D4) is not plugged in" in problem
    assert "--new-adapters" not in problem


def test_a_damaged_memory_is_reported_and_does_not_prevent_a_start(tmp_path: Path) -> None:
    path = tmp_path / "adapters.json"
    path.write_text("{")
    adapters = Adapters(path, lambda: [LEFT])
    assert "cannot be read" in adapters.problem
    assert adapters.problem_of("left", LEFT.device) == ""

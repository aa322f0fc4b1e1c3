"""Messages about a missed deadline say so if this computer is too busy."""

from __future__ import annotations

import pytest

from strands_actors.kernel.health import busy
from strands_actors.kernel.health.busy import IDLE, Machine, assumed, explained, machine

STARVED = Machine(20.2, 2)


def test_the_busy_computer_is_named_between_the_problem_and_the_remedy() -> None:
    why = "read: so101 is silent for 530 ms. Check power and cable"
    with assumed(STARVED):
        text = explained(why)
        assert explained(text) == text, "the explanation is added only once"
    assert text == (
        "read: so101 is silent for 530 ms (this computer is busy: load 20 on 2 cores). Check power and cable"
    )
    with assumed(IDLE):
        assert explained(why) == why


@pytest.mark.parametrize(
    ("seen", "is_busy", "text"),
    [
        (Machine(2.9, 2), False, "load 3 on 2 cores"),
        (Machine(3.0, 2), True, "load 3 on 2 cores"),
        (Machine(0.4, 1, 0.02), False, "load 0 on 1 core, 2 % of the last 10 s waited for one"),
        (Machine(0.4, 4, 0.35), True, "load 0 on 4 cores, 35 % of the last 10 s waited for one"),
    ],
)
def test_load_and_pressure_both_count(seen: Machine, is_busy: bool, text: str) -> None:
    assert (seen.busy, seen.text) == (is_busy, text)


def test_the_load_of_this_computer_can_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(busy, "_assumed", None)
    seen = machine()
    assert seen.load >= 0 and seen.cores >= 1

    def unknown() -> tuple[float, float, float]:
        raise OSError

    monkeypatch.setattr("os.getloadavg", unknown)
    monkeypatch.setattr(busy, "pressure", lambda: None)
    assert machine().load == 0.0 and not machine().busy

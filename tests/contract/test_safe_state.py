"""Test that safe states are ordered, and that an incomplete table of fallbacks does not load."""

from __future__ import annotations

import pytest

from strands_actors.contract.driver import Condition, Reason
from strands_actors.contract.fallbacks import check_fallbacks
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.loading import build_driver
from strands_actors.testing.fake import HARDWARE, FakeDriver, FakeHardware


def test_the_order_of_severity() -> None:
    assert SafeState.LIMP.at_least(SafeState.HOLD) and not SafeState.HOLD.at_least(SafeState.LIMP)
    assert SafeState.HOLD.at_least(SafeState.HOLD)
    assert sorted(SafeState, key=lambda state: state.severity)[0] is SafeState.HOLD


def test_fallbacks_are_complete_and_spelt_right() -> None:
    whole = dict.fromkeys(Reason, "hold")
    assert all(state is SafeState.HOLD for state in check_fallbacks("r", whole).values())
    with pytest.raises(ValueError, match="r: no safe state is declared for estop"):
        check_fallbacks("r", {reason: state for reason, state in whole.items() if reason is not Reason.ESTOP})
    with pytest.raises(ValueError, match=r"r: hodl is no safe state\. Use one of hold, zero"):
        check_fallbacks("r", {**whole, Reason.STOP: "hodl"})


def fine(observation: Observation, now_ns: int) -> Refused | None:
    return None


def test_texts_in_a_driver_become_safe_states_when_it_is_built() -> None:
    class Worded(FakeDriver):
        fallbacks = dict.fromkeys(Reason, "limp")  # type: ignore[assignment]
        conditions = (Condition(fine, Reason.FAULT, "off"), Condition(fine))  # type: ignore[arg-type]

    HARDWARE["words"] = FakeHardware()
    driver = build_driver(Worded, "fake", "words", {})
    assert all(state is SafeState.LIMP for state in driver.fallbacks.values())
    assert [condition.safe_state for condition in driver.conditions] == [SafeState.OFF, None]
    Worded.conditions = (Condition(fine, Reason.FAULT, "of"),)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"fake: of is no safe state\. Use one of hold"):
        build_driver(Worded, "fake", "words", {})

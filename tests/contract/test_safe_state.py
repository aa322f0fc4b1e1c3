"""Safe states have an order, and a table of fallbacks is complete or does not load."""

from __future__ import annotations

import pytest

from strands_actors.contract.driver import Reason
from strands_actors.contract.fallbacks import check_fallbacks
from strands_actors.contract.safe_state import SafeState


def test_the_order_of_severity() -> None:
    assert SafeState.LIMP.at_least(SafeState.HOLD) and not SafeState.HOLD.at_least(SafeState.LIMP)
    assert SafeState.HOLD.at_least(SafeState.HOLD)
    assert sorted(SafeState, key=lambda state: state.severity)[0] is SafeState.HOLD


def test_fallbacks_are_complete_and_spelt_right() -> None:
    whole = dict.fromkeys(Reason, "hold")
    check_fallbacks("r", whole)
    with pytest.raises(ValueError, match="r: no safe state is declared for estop"):
        check_fallbacks("r", {reason: state for reason, state in whole.items() if reason is not Reason.ESTOP})
    with pytest.raises(ValueError, match=r"r: hodl is no safe state\. Use one of hold, zero"):
        check_fallbacks("r", {**whole, Reason.STOP: "hodl"})

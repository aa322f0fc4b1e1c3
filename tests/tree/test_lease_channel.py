"""SAF-017: a lease belongs to the channel over which it was acquired. A holder's name or a lease's number
from another channel is not accepted.
"""

from __future__ import annotations

import pytest

from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.lease import Leases
from strands_actors.supervisors.gate.messages import Acquire, Beat

CALLER, POLICY = "so101 in process 1", "policy process 7"
SECOND_NS = 10**9


def begun() -> tuple[Leases, int, int]:
    """Return leases with a caller's lease, and that of its policy process under it."""
    leases = Leases(0)
    over = leases.acquire(Acquire(CALLER), 0)
    assert isinstance(over, int)
    own = leases.acquire(Acquire("policy of so101", over, 7, POLICY), 0)
    assert isinstance(own, int)
    return leases, over, own


@pytest.mark.parametrize("after_s", [0, 5])
def test_saf_017_a_policy_process_gets_no_lease_without_its_callers(after_s: int) -> None:
    """Neither the caller's lease, with the holder's name from the refusal, nor one that has expired."""
    leases = Leases(0)
    leases.acquire(Acquire(CALLER), 0)
    refused = leases.acquire(Acquire(CALLER, 0, 1, POLICY), after_s * SECOND_NS)
    assert isinstance(refused, Refused)
    assert refused.code == "channel"


def test_saf_017_a_lease_is_valid_over_its_own_channel_only() -> None:
    leases, over, own = begun()
    assert leases.refuse(own, POLICY) is None
    assert leases.refuse(own, "") is not None
    assert leases.refuse(own, "policy process 8") is not None
    assert leases.release(own, "") is None
    assert leases.release(own, POLICY) is not None
    assert leases.refuse(over, "") is None
    assert leases.refuse(over, POLICY) is not None, "the lease belongs to the caller"
    assert leases.release(over, POLICY) is None


def test_saf_017_a_policy_process_cannot_keep_its_callers_lease_alive() -> None:
    leases, over, _ = begun()
    leases.beat(Beat(over, 0.0, POLICY), SECOND_NS // 2)
    assert leases.lapsed(SECOND_NS, latched=False)
    leases.beat(Beat(over), SECOND_NS // 2)
    assert not leases.lapsed(SECOND_NS, latched=False)


def test_a_rollout_is_reported_while_heartbeats_arrive_for_it() -> None:
    leases, _, own = begun()
    assert leases.rollout(SECOND_NS // 2) is not None
    assert leases.rollout(SECOND_NS) is None
    leases.release(own, POLICY)
    assert leases.rollout(0) is None, "the caller commands now"


def test_saf_017_a_policy_process_that_acquires_again_invalidates_its_first_lease() -> None:
    leases, over, first = begun()
    again = leases.acquire(Acquire("policy of so101", over, 7, POLICY), 0)
    assert isinstance(again, int) and again != first
    assert leases.refuse(again, POLICY) is None
    assert leases.refuse(first, POLICY) is not None
    assert leases.release(again, POLICY) is not None
    assert leases.held is not None and leases.held.id == over, "the caller's lease is the next one below"


def test_saf_017_the_next_policy_process_gets_no_lease_under_the_earlier_ones() -> None:
    leases, _, own = begun()
    refused = leases.acquire(Acquire("policy of so101", own, 8, "policy process 8"), 0)
    assert isinstance(refused, Refused)
    assert refused.code == "lease"


@pytest.mark.parametrize("again", [0, 7, 1 << 32 | 7])
def test_saf_017_a_holders_name_is_not_enough_and_a_number_cannot_be_guessed(again: int) -> None:
    leases = Leases(0, secret=b"of this gate alone")
    lease = leases.acquire(Acquire(CALLER), 0)
    assert isinstance(lease, int)
    refused = leases.acquire(Acquire(CALLER, again=again), 0)
    assert isinstance(refused, Refused)
    assert refused.code == "lease"
    assert leases.refuse(lease, "") is None, "the holder keeps its lease"
    assert isinstance(leases.acquire(Acquire(CALLER, again=lease), 0), int)


@pytest.mark.parametrize(("has_it", "holding", "granted"), [(1, True, True), (1, False, False), (0, True, False)])
def test_a_caller_regains_the_lease_of_its_rollout_when_the_robot_holds(
    has_it: bool, holding: bool, granted: bool
) -> None:
    """A rollout that was interrupted does not return its lease."""
    leases, over, own = begun()
    taken = leases.acquire(Acquire(CALLER, again=over if has_it else 0), SECOND_NS // 2, holding)
    assert isinstance(taken, int) is granted
    assert (leases.refuse(own, POLICY) is None) is not granted

"""Run tests of robots with periods of milliseconds one at a time, parallel to other tests, and first.

A tree at 500 Hz and its twin need most of a processor. For two such pairs at the same time, two
processors are not enough. Then their robots correctly report an old state or a lost link, but their tests
test something else.
"""

from __future__ import annotations

import fcntl
import re
from collections.abc import Generator

import pytest

NAMES = re.compile(
    "(?<![a-z])(ur5?e?|unitree|g1|go2|legs?|rtps|booster|t1|franka|panda|fr3|kuka|iiwa|kinova|gen3|rby1|xarm7?|lite6|fleet)(?![a-z0-9])"
)
"""Parts of the names of such tests, or of their files. They have robots with a state that is too old
after 75 to 200 ms, or many robots at a time. Other such tests have the mark ``real_time``."""

PURE = re.compile(
    "test_(arms|built_in_policies|calls|construction|contract|factory|fragments|fuzz|gates|generator|kinematics|late_requests"
    "|messages|page_keywords|plans|protocol|reference_behaviours|resend_rates|session|signatures|twin_programs|virtual)"
)
"""Files without a running robot, or in virtual time: the real clock does not matter to them. They must not
wait for the lock, because a waiting test blocks a worker."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark these tests, and put them first. One worker then gets all of them, and a worker that has no
    tests left takes some from it."""
    for item in items:
        # The time of the explorer is simulated.
        if "explore" in item.path.parts or PURE.match(item.path.stem):
            continue
        if NAMES.search(item.nodeid):
            item.add_marker(pytest.mark.real_time)
    items.sort(key=lambda item: item.get_closest_marker("real_time") is None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Hold the lock during a test. That includes the set-up of the robots that its module shares."""
    if item.get_closest_marker("real_time") is None:
        return (yield)
    with open(__file__) as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            return (yield)
        finally:
            # A process that was forked meanwhile has inherited the lock. This releases it there, too.
            fcntl.flock(lock, fcntl.LOCK_UN)

"""Tests of robots that count milliseconds run one at a time, beside the others, and first.

A tree of 500 Hz and its twin take most of a processor. Two of them beside each other on two have
too little, and what their tests see is right, but not what they are about: a state that is too old,
a link that is lost.
"""

from __future__ import annotations

import fcntl
import re
from collections.abc import Generator

import pytest

NAMES = re.compile(
    "(?<![a-z])(ur5?e?|unitree|g1|go2|legs?|rtps|booster|t1|franka|panda|fr3|kuka|iiwa|kinova|gen3|rby1|xarm7?|lite6|fleet)(?![a-z0-9])"
)
"""Parts of the names of such tests, or of their files: robots whose state is too old after 75 to
200 ms, and many robots at a time. Others are marked ``real_time``."""

PURE = re.compile(
    "test_(arms|built_in_policies|calls|construction|contract|factory|fragments|fuzz|gates|generator|kinematics|late_requests"
    "|messages|page_keywords|plans|protocol|reference_behaviours|resend_rates|session|signatures|twin_programs|virtual)"
)
"""Files without a robot that runs, or in virtual time: for them a clock is a number. To wait for another
test would keep a worker from the others."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """First: one worker gets them all, and who is done with the others takes some from it."""
    for item in items:
        if "explore" in item.path.parts or PURE.match(item.path.stem):  # the former's time is simulated
            continue
        if NAMES.search(item.nodeid):
            item.add_marker(pytest.mark.real_time)
    items.sort(key=lambda item: item.get_closest_marker("real_time") is None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """With the robots that its module shares, which are set up here, too."""
    if item.get_closest_marker("real_time") is None:
        return (yield)
    with open(__file__) as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            return (yield)
        finally:
            fcntl.flock(lock, fcntl.LOCK_UN)  # of what was forked meanwhile, too

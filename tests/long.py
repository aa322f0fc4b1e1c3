"""Mark the tests that ``python -m tests`` leaves out and ``python -m tests long`` runs.

A long test repeats a shorter one on another robot, with another fault or in a whole program.
``@pytest.mark.long`` marks a test. ``@pytest.mark.quick_cases(2)`` marks all cases of a parametrised test
but the first two. A direct call of ``pytest`` runs long and short tests.
"""

from __future__ import annotations

from collections import Counter

import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests before ``-m`` selects among them."""
    cases: Counter[str] = Counter()
    for item in items:
        marker = item.get_closest_marker("quick_cases")
        if marker is None:
            continue
        test = item.nodeid.partition("[")[0]
        cases[test] += 1
        if cases[test] > marker.args[0]:
            item.add_marker(pytest.mark.long)

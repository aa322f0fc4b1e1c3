"""What ``python -m tests`` leaves out, and ``python -m tests long`` runs: tests that take long and
repeat, on another robot, with another fault or in a whole program, what shorter ones show.

``@pytest.mark.long`` marks one. ``@pytest.mark.quick_cases(2)`` marks all cases of a parametrised
test but the first two. Who calls ``pytest`` itself runs both.
"""

from __future__ import annotations

from collections import Counter

import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Before ``-m`` selects among them."""
    cases: Counter[str] = Counter()
    for item in items:
        marker = item.get_closest_marker("quick_cases")
        if marker is None:
            continue
        test = item.nodeid.partition("[")[0]
        cases[test] += 1
        if cases[test] > marker.args[0]:
            item.add_marker(pytest.mark.long)

"""The ten lines that the author of a third-party driver writes for a column of the matrix."""

from __future__ import annotations

import pytest

from strands_actors.testing import Check, conformance

from .blinky import Blinky


@pytest.mark.parametrize("check", conformance(Blinky, good={"joint": 5.0}), ids=str)
def test_my_driver(check: Check) -> None:
    check()

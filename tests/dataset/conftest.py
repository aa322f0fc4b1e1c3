"""The SO-101 and its twin that the tests record."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.testing import Twin


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("so101", tmp_path) as twin:
        yield twin


@pytest.fixture
def arm(twin: Twin) -> Iterator[Any]:
    with Robot("so101", mode="real", port=twin.port) as arm:
        yield arm

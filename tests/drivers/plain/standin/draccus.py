"""Stand-in for the reader of LeRobot's configs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def decode(config_class: Any, given: Mapping[str, Any]) -> Any:
    return config_class(**given)

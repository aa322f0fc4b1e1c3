"""A stub of ``gi.repository`` that has every attribute."""

from __future__ import annotations

from unittest.mock import MagicMock


def __getattr__(name: str) -> MagicMock:
    if name.startswith("_"):
        raise AttributeError(name)
    return MagicMock(name=f"gi.repository.{name}")

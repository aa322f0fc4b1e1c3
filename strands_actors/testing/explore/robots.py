"""The robots that are modelled."""

from __future__ import annotations

ROBOTS = ("so101",)

"""The arm and the twin of ``tests/robot``."""

from __future__ import annotations

from tests.robot.conftest import arm, new_arm, twin, twin_process

__all__ = ["arm", "new_arm", "twin", "twin_process"]

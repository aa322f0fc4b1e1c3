from __future__ import annotations

from tests.cli.conftest import cli, robot

__all__ = ["cli", "robot"]

"""The command line of ``tests/cli``, and a robot on a twin."""

from __future__ import annotations

from tests.cli.conftest import cli, robot

__all__ = ["cli", "robot"]

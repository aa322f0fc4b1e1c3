from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from .command import Command, RobotProcess


@pytest.fixture
def cli() -> Iterator[Command]:
    """Give the command with a separate run directory, in which it sees only the robots of this test."""
    directory = Path(tempfile.mkdtemp(prefix="sa-"))  # short: sockets live there
    command = Command(directory)
    try:
        yield command
        command.wait_until_gone()
    finally:
        shutil.rmtree(directory, ignore_errors=True)


@pytest.fixture
def robot(cli: Command) -> Iterator[RobotProcess]:
    with RobotProcess(cli) as process:
        yield process

"""Run ``strands-actors web``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tests.cli.command import Command


@contextmanager
def console_of(cli: Command, *arguments: str) -> Iterator[dict[str, Any]]:
    """Run the command, and yield what it prints."""
    with cli.start("web", "--port", "0", "--json", *arguments) as process:
        try:
            assert process.stdout is not None and process.stderr is not None
            line = process.stdout.readline()
            assert line, process.stderr.read()
            yield json.loads(line)
            process.terminate()
            assert process.wait(20) == 0
        finally:
            process.kill()

"""A session with a Franka arm, by the vendor's own client in its environment."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

from ..fetch import fetch
from ..table import clients
from .compare import Event

CLIENT = "pylibfranka"
PROGRAM = Path(__file__).with_name("libfranka_session.py")
WITHIN_S = 240.0


def session(address: str) -> Iterator[Event]:
    """Run the session, and yield its events. If the client does not end, the events so far are all."""
    (client,) = (one for one in clients() if one.name == CLIENT)
    command = [str(fetch(client).python), str(PROGRAM), address.partition(":")[0]]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=WITHIN_S)
    except subprocess.TimeoutExpired as late:
        output = late.stdout or b""
        yield from _events(output.decode() if isinstance(output, bytes) else output)
        yield Event(f"the client did not end within {WITHIN_S:g} s")
        return
    yield from _events(done.stdout)
    if done.returncode:
        lines = done.stderr.strip().splitlines()
        yield Event("the client failed", answer=lines[-1] if lines else str(done.returncode))


def _events(output: str) -> Iterator[Event]:
    for line in output.splitlines():
        if line.startswith("{"):
            yield Event(**json.loads(line))


__all__ = ["session"]

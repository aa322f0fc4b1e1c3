"""Sessions by the vendors' own clients, each in its environment."""

from __future__ import annotations

import functools
import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

from ..fetch import Fetched, fetch
from ..table import clients
from .compare import Event

HERE = Path(__file__).parent
WITHIN_S = 240.0


def fetched(name: str) -> Fetched:
    """Return a client of ``clients.toml`` from the cache. Raise ``NotFetched``."""
    (client,) = (one for one in clients() if one.name == name)
    return fetch(client)


def session(client: str, program: str, address: str) -> Iterator[Event]:
    """Run a session, and yield its events. If the client does not end, the events so far are all.

    Args:
        client: The client, by its name in ``clients.toml``.
        program: A file of this folder, which takes the host and prints each event as JSON.
        address: The robot.
    """
    command = [str(fetched(client).python), str(HERE / program), address.partition(":")[0]]
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


franka = functools.partial(session, "pylibfranka", "libfranka_session.py")
unitree = functools.partial(session, "unitree-sdk2py-dimos", "unitree_session.py")

__all__ = ["fetched", "franka", "unitree"]

"""The wire log: what was on the wire and when, one JSON object a line. Safety tests read it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Literal

Source = Literal["host", "robot", "control"]
"""``control``: what the simulation was told, beside the wire (see ``common.control``)."""


class WireLog:
    """Lines reach the file before ``write`` returns: a reader, or a crash, sees every frame that
    was."""

    def __init__(self, path: str | None) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
        self._fd = None if path is None else os.open(path, flags, 0o644)

    def write(
        self, t_ns: int, source: Source, frames: Iterable[tuple[str, bytes]], safe_state: str | None = None
    ) -> None:
        """Log frames, each with its kind, that were on the wire together. ``t_ns``:
        CLOCK_MONOTONIC. ``safe_state``: what they bring the whole robot to by themselves; "" is
        none, None that nobody has said."""
        if self._fd is None:
            return
        end = "" if safe_state is None else f', "safe_state": "{safe_state}"'
        lines = [
            f'{{"t_ns": {t_ns}, "from": "{source}", "kind": "{kind}", "hex": "{data.hex()}"{end}}}\n'
            for kind, data in frames
        ]
        os.write(self._fd, "".join(lines).encode())

    def close(self) -> None:
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

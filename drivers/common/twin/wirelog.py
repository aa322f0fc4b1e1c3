"""The wire log: every frame on the wire with its time, one JSON object a line. Safety tests read it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Literal

Source = Literal["host", "robot", "control"]
"""``control``: requests to the simulation, not on the wire (see ``common.simulation_control``)."""


class WireLog:
    """Writes each line to the file before ``write`` returns, so that a reader sees every frame, even after
    a crash."""

    def __init__(self, path: str | None) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
        self._fd = None if path is None else os.open(path, flags, 0o644)

    def write(
        self, t_ns: int, source: Source, frames: Iterable[tuple[str, bytes]], safe_state: str | None = None
    ) -> None:
        """Log frames that were on the wire together.

        Args:
            t_ns: Time in ns of CLOCK_MONOTONIC.
            source: The sender.
            frames: Kind and bytes of each frame.
            safe_state: The safe state that these frames alone bring the whole robot to; empty if they
                bring it to none, None if unknown.
        """
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

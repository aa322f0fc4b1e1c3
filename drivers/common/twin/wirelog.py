"""The log of a simulated robot's protocol: every frame with its time, one JSON object per line. Safety tests read
it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Literal

Source = Literal["host", "robot", "control"]
"""``control``: requests to the simulation, not on the wire (see ``common.simulation_control``)."""


class WireLog:
    """Write the log of a simulated robot's protocol. Each line is in the file before ``write`` returns, so that a
    reader sees every frame even after a crash."""

    def __init__(self, path: str | None) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
        self._fd = None if path is None else os.open(path, flags, 0o644)

    def write(
        self, t_ns: int, source: Source, frames: Iterable[tuple[str, bytes]], safe_state: str | None = None
    ) -> None:
        """Log frames that were sent together.

        Args:
            t_ns: Time in ns of CLOCK_MONOTONIC.
            source: The sender of the frames.
            frames: Kind and bytes of each frame.
            safe_state: The safe state (for example ``hold``) to which these frames alone bring the whole robot;
                empty if they do not bring it to a safe state, None if that is unknown.
        """
        if self._fd is None:
            return
        end = "" if safe_state is None else f', "safe_state": "{safe_state}"'
        lines = [
            f'{{"t_ns": {t_ns}, "from": "{source}", "kind": "{kind}", "hex": "{data.hex()}"{end}}}\n'
            for kind, data in frames
        ]
        if lines:
            os.write(self._fd, "".join(lines).encode())

    def close(self) -> None:
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

"""A recorder that records a moving robot, so that the kill matrix can break it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
from pathlib import Path

from strands_actors.kernel.processes.interpreter import PYTHON, environment


class RecorderProcess:
    """A recorder, started as ``strands_actors.record`` does. The file that it writes is not read."""

    def __init__(self, robot: str, run_dir: Path) -> None:
        self._directory = tempfile.TemporaryDirectory(prefix="sa-")
        self._process = subprocess.Popen(
            [*PYTHON, "-m", "strands_actors.surfaces.recording.script", robot, f"{self._directory.name}/run.mcap"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment(STRANDS_ACTORS_RUN=str(run_dir)),
        )

    @property
    def alive(self) -> bool:
        """True while the recorder's process exists, also if it is frozen."""
        return self._process.poll() is None

    def end(self) -> None:
        """Kill the recorder, even if it is frozen."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._directory.cleanup()

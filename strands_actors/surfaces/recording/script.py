"""Record from a script, ``with record(robot, "run.mcap"):``. The recorder runs in a separate process."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

import trio

from strands_actors.kernel.processes.interpreter import PYTHON, environment

from .arguments import name_of_started, path_of
from .errors import RecordingError
from .to_file import record_until_stopped

END_S = 15.0
STARTED = "recording"


class Named(Protocol):
    @property
    def name(self) -> str: ...


@contextmanager
def record(robot: str | Named, path: str | Path) -> Iterator[None]:
    """Record a robot while the block runs. A failure of the recorder does not affect the robot.

    Args:
        robot: A robot, or the name of a running robot. A robot that is not connected yet is connected first.
        path: The new file.

    Raises:
        RecordingError: The robot cannot be recorded, or the recorder has failed.
    """
    path = path_of("record", "path", path)
    name = name_of_started("record", robot)
    process = subprocess.Popen(
        [*PYTHON, "-m", __name__, name, str(path)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )
    try:
        assert process.stdout is not None
        if process.stdout.readline().strip() != STARTED:
            raise RecordingError(_error_text(process))
        yield
    finally:
        process.send_signal(signal.SIGINT)
        try:
            _, error_text = process.communicate(timeout=END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise RecordingError(f"the recorder did not finish {path} within {END_S:g} s") from None
    if process.returncode:
        raise RecordingError(error_text.strip() or f"the recorder ended with code {process.returncode}")


def _error_text(process: subprocess.Popen[str]) -> str:
    _, error_text = process.communicate(timeout=END_S)
    return error_text.strip() or f"the recorder ended with code {process.returncode}"


def main() -> int:
    """Run the recorder's process. Its arguments are the robot's name and the path."""
    name, path = sys.argv[1:]
    # If the parent process ignores SIGINT, so does this process. Therefore set the default handler.
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def on_started() -> None:
        print(STARTED, flush=True)

    try:
        trio.run(record_until_stopped, name, Path(path), None, on_started, lambda seconds, file: None)
    except (RecordingError, OSError) as problem:
        print(" ".join(str(problem).split()), file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Record a robot into an MCAP file."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import msgspec
import trio

from strands_actors.caller.processes.background import open_background
from strands_actors.supervisors.instrument import Attached

from .code import driver_class_of, fingerprint
from .errors import RecordingError
from .file import RecordingFile, new_info
from .recorder import Ending, Recorder, visit


class Summary(msgspec.Struct):
    """A summary of a recording: its length, its size, and the number of rows of each kind."""

    path: str
    robot: str
    seconds: float
    bytes: int
    commands: int
    refusals: int
    observations: int
    safe: int
    gaps: int
    ended: str  # The reason why the recording ended.


async def record_until_stopped(
    robot: str,
    path: Path,
    seconds: float | None,
    on_started: Callable[[], None],
    on_progress: Callable[[float, RecordingFile], None],
) -> Summary:
    """Record until Ctrl-C or SIGTERM, for ``seconds``, or until the robot has ended. Call this in the main
    thread.

    Args:
        robot: The name of a running robot.
        path: The new file.
        seconds: How long to record; None for no limit.
        on_started: Called when the file is open.
        on_progress: Called once a second, with the length of the recording in seconds and the file.

    Raises:
        RecordingError: The robot cannot be recorded, or the file cannot be made.
        OSError: The file cannot be written.
    """
    _require_free(path)
    files: list[RecordingFile] = []

    def open_file(attached: Attached) -> RecordingFile:
        files.append(RecordingFile(path, new_info(robot, _fingerprint(attached), attached)))
        on_started()
        return files[0]

    with trio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async with visit(robot) as node, open_background() as nursery:
            recorder = Recorder(robot, open_file, on_progress)

            async def listen() -> None:
                async for _ in signals:
                    recorder.end("interrupted")

            nursery.start_soon(listen)
            ending = await recorder.run(node, seconds)
    return _summary(robot, files[0], ending)


def _require_free(path: Path) -> None:
    """Raise ``RecordingError`` if the file cannot be made. Check this before connecting to the robot, because a
    robot serves only one recorder at a time."""
    if path.exists():
        raise RecordingError(f"{path} exists already. Give another name, or remove it")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise RecordingError(f"the folder {folder} does not exist. Make it, or give another path")
    if not os.access(folder, os.W_OK):
        raise RecordingError(f"the folder {folder} is not writable. Use another folder")


def _fingerprint(attached: Attached) -> str:
    try:
        return fingerprint(driver_class_of(attached.driver))
    except RecordingError:
        return ""  # The driver is not installed here. The recording can be viewed, but not replayed.


def _summary(robot: str, file: RecordingFile, ending: Ending) -> Summary:
    counts = file.counts
    return Summary(
        str(file.path),
        robot,
        ending.seconds,
        file.path.stat().st_size,
        counts["command"],
        counts["refusal"],
        counts["observation"],
        counts["safe"],
        counts["gap"],
        ending.reason,
    )

"""Show how a rollout of a policy goes on, in one line of a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TextIO

from strands_actors.supervisors.gate.messages import Status
from strands_actors.supervisors.root.messages import TaskStatus

LOOK_S = 0.1
"""Period in which a blocking ``run`` reads the status of its rollout."""
LINE_S = 1.0
"""Period of the lines if standard error is no terminal."""

Show = Callable[[Mapping[str, Any]], object]
"""Gets the progress of a rollout: ``Progress`` as a dictionary."""


class Progress(NamedTuple):
    """How far a rollout is.

    Attributes:
        running: False after its end.
        steps: Number of setpoints that it has sent.
        hz: Setpoints per second since the first one.
        elapsed_s: Time since its first action, or since its start while it loads (s).
        observation_age_s: Age of the newest reading of the robot (s); None without a reading.
        refused: Number of setpoints and requests that the gate has refused since the start.
    """

    running: bool
    steps: int
    hz: float
    elapsed_s: float
    observation_age_s: float | None
    refused: int


def progress_of(task: TaskStatus, gate: Status | None, refused_before: int) -> Progress:
    """Return the progress of a rollout. Pure.

    Args:
        task: The status of the rollout.
        gate: The status of the gate, which checks each command; None if it did not answer.
        refused_before: The gate's number of refusals at the start.
    """
    age_s = None if gate is None or gate.age_s < 0 else round(gate.age_s, 4)
    refused = 0 if gate is None else max(0, gate.refusals - refused_before)
    return Progress(task.running, task.steps, round(task.hz, 2), round(task.elapsed_s, 3), age_s, refused)


def line_of(progress: Mapping[str, Any], seconds: float) -> str:
    """Return a progress as a line for people. Pure.

    Args:
        progress: ``Progress`` as a dictionary.
        seconds: The planned duration.
    """
    if not progress["steps"]:
        return f"the policy is loading, {progress['elapsed_s']:.1f} s"
    age_s = progress["observation_age_s"]
    age = "no reading" if age_s is None else f"newest reading {age_s * 1e3:.0f} ms old"
    rate, refused = progress["hz"], progress["refused"]
    time = f"{progress['elapsed_s']:5.1f} of {seconds:g} s"
    return f"{time}  {progress['steps']:6} steps  {rate:6.1f} steps/s  {age}  {refused} refused"


class TerminalLine:
    """Show progress on standard error. On a terminal one line is replaced, elsewhere a line comes each second.

    Args:
        seconds: The planned duration of the rollout.
        stream: Where it writes; None for standard error.
    """

    def __init__(self, seconds: float, stream: TextIO | None = None) -> None:
        self._seconds = seconds
        self._stream = sys.stderr if stream is None else stream
        self._is_terminal = self._stream.isatty()
        self._shown_s = 0.0

    def __call__(self, progress: Mapping[str, Any]) -> None:
        """Show a progress."""
        if not progress["running"] and not progress["steps"]:
            return  # It has ended before its first step. The answer of ``run`` has the reason.
        line = line_of(progress, self._seconds)
        if self._is_terminal:
            # The import takes some milliseconds, and only a terminal needs it.
            import shutil

            width = shutil.get_terminal_size().columns - 1
            end = "" if progress["running"] else "\n"
            print(f"\r\x1b[K{line[:width]}", end=end, file=self._stream, flush=True)
        elif not progress["running"] or progress["elapsed_s"] >= self._shown_s + LINE_S:
            self._shown_s = progress["elapsed_s"]
            print(line, file=self._stream, flush=True)


def show_of(progress: Show | bool | None, seconds: float) -> Show | None:
    """Return the function that shows the progress; None if nothing is shown.

    Args:
        progress: The argument ``progress`` of ``run``: a function; True for lines on standard error; False for
            nothing; None for lines only on a terminal.
        seconds: The planned duration.

    Raises:
        TypeError: It has another type.
    """
    if progress is False or (progress is None and not sys.stderr.isatty()):
        return None
    if progress is None or progress is True:
        return TerminalLine(seconds)
    if not callable(progress):
        raise TypeError(f"progress is {progress!r}. Give True, False or a function")
    return progress


__all__ = ["LOOK_S", "Progress", "Show", "TerminalLine", "line_of", "progress_of", "show_of"]

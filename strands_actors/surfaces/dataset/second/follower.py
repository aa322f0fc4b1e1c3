"""Let a separate process copy the finished episodes of a recording. While it records, the recorder never waits for
this process.

If this process ends, it is started again. If the place cannot be used, the recording continues, and the process
tries again.
"""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Callable

import msgspec
import trio

from strands_actors.kernel.processes.interpreter import PYTHON, environment
from strands_actors.kernel.processes.lines import lines_of
from strands_actors.surfaces.dataset.errors import DatasetError

from .process import Status

CHILD = f"{__package__}.process"
FIRST_S = 30.0
"""Before the recording begins, wait so long for the first answer, in seconds. Then record nevertheless."""
AGAIN_S = (1.0, 2.0, 5.0, 10.0, 30.0)
"""Times before an ended process is started again, in seconds. The last one is repeated."""
LEAVE_S = 20.0
"""Longest time for the last episodes to be copied at the end of a recording, in seconds."""


class Follower:
    """Starts and watches the process that copies a dataset to its second place."""

    def __init__(self, root: str, url: str, tell: Callable[[str], None]) -> None:
        """Start nothing yet.

        Args:
            root: The folder of the dataset.
            url: The second place.
            tell: Called with each message for the user.
        """
        self._root = root
        self._url = url
        self._tell = tell
        self.process: trio.Process | None = None
        self._first = trio.Event()
        self._ended = trio.Event()
        self._is_leaving = False
        self.status = Status()

    async def run(self) -> None:
        """Run the process, until it refuses the place or ``leave`` is called."""
        ends = 0
        try:
            while not self._is_leaving and not self.status.refused:
                await self._run_once()
                if not self._is_leaving and not self.status.refused:
                    self._tell(f"the process that copies to {self._url} has ended. It is started again")
                    await trio.sleep(AGAIN_S[min(ends, len(AGAIN_S) - 1)])
                    ends += 1
        finally:
            self._first.set()
            self._ended.set()

    async def require_accepted(self) -> None:
        """Wait for the first answer of the place, for ``FIRST_S`` at most.

        Raises:
            DatasetError: The place can never take this dataset.
        """
        with trio.move_on_after(FIRST_S) as scope:
            await self._first.wait()
        if scope.cancelled_caught:
            self._tell(f"{self._url} does not answer. Recording continues, and episodes are copied later")
        if self.status.refused:
            raise DatasetError(self.status.refused)

    async def leave(self, episodes: int) -> str:
        """Wait until the last episodes are copied, for ``LEAVE_S`` at most, and end the process.

        Args:
            episodes: Number of episodes of the dataset.

        Returns:
            What is not copied, as text. Empty if every episode is in the second place.
        """
        self._is_leaving = True
        with trio.move_on_after(LEAVE_S):
            if self.process is not None and self.process.stdin is not None:
                await self.process.stdin.aclose()
            await self._ended.wait()
        if self.process is not None:
            with contextlib.suppress(OSError):
                self.process.kill()
        missing = episodes - self.status.episodes
        if missing <= 0:
            return ""
        reason = self.status.refused or self.status.problem or f"it took longer than {LEAVE_S:g} s"
        return (
            f"{missing} of {episodes} episodes are not in the second place yet ({reason}). "
            f"Copy them with `strands-actors dataset copy {self._root} {self._url}`"
        )

    async def _run_once(self) -> None:
        self.process = await trio.lowlevel.open_process(
            [*PYTHON, "-m", CHILD, self._root, self._url],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # pyarrow's own log lines. Every failure is in a status.
            env=environment(),
            start_new_session=True,  # Ctrl-C on the terminal ends the recorder, which then ends this process.
        )
        assert self.process.stdout is not None
        try:
            async for line in lines_of(self.process.stdout):
                self._take(msgspec.json.decode(line, type=Status))
            await self.process.wait()
        except BaseException:
            self.process.kill()
            raise

    def _take(self, status: Status) -> None:
        before, self.status = self.status, status
        if status.refused and self._first.is_set():
            self._tell(f"nothing more is copied: {status.refused}")
        elif status.problem and status.problem != before.problem:
            self._tell(f"not copied: {status.problem}. Recording continues, and copying is tried again")
        elif status.episodes > before.episodes and self._first.is_set():
            last = status.episodes - 1
            self._tell(f"{f'episode {last}' if last == before.episodes else f'episodes up to {last}'}: "
                       f"copied to {self._url}")  # fmt: skip
        elif before.problem and not status.problem:
            self._tell(f"{self._url} can be used again")
        self._first.set()

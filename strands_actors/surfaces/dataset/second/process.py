"""The process that copies finished episodes to the second place while a recorder records.

It looks twice a second whether the dataset has a new episode. It writes a ``Status`` as a line of JSON when
something changes. It ends when its standard input ends: then the recorder has ended, or was killed. Before, it
copies the missing files, once.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import time
from pathlib import Path

import msgspec

from strands_actors.surfaces.dataset.errors import DatasetError
from strands_actors.surfaces.dataset.index import Index
from strands_actors.surfaces.dataset.layout import INFO

from .bring import bring
from .opening import open_place
from .place import Place, PlaceError

LOOK_S = 0.5
RETRY_S = (1.0, 2.0, 5.0, 10.0, 30.0)
"""Waiting times after failures in a row, in seconds. The last one is repeated."""
STDIN = 0


class Status(msgspec.Struct, frozen=True):
    """The state of the second place.

    Attributes:
        episodes: Number of episodes that are complete there.
        problem: Why the place cannot be used at the moment. Empty if it can.
        refused: Why the place can never take this dataset. The process then ends.
    """

    episodes: int = 0
    problem: str = ""
    refused: str = ""


class Follow:
    """Copies a dataset that grows."""

    def __init__(self, root: Path, url: str) -> None:
        self._root = root
        self._url = url
        self._place: Place | None = None
        self._copied: object = None  # The version of info.json that was copied.
        self._episodes = 0
        self._last_status: Status | None = None

    def run(self) -> int:
        """Copy until standard input ends. Return the exit code."""
        failures = 0
        is_last = False
        while True:
            try:
                self._copy()
                failures = 0
            except PlaceError as problem:
                failures += 1
                self._close()
                self.tell(Status(self._episodes, problem=str(problem)))
            except DatasetError as refusal:
                self.tell(Status(self._episodes, refused=str(refusal)))
                return 1
            if is_last:
                return 0
            is_last = _ends_within(RETRY_S[min(failures, len(RETRY_S)) - 1] if failures else LOOK_S)

    def _copy(self) -> None:
        version = self._version()
        if self._last_status is not None and not self._last_status.problem and version == self._copied:
            return
        self._place = self._place or open_place(self._url, self._root)
        if version is None:
            # The dataset has no episode yet. Show now that the place can be read, and has no other dataset.
            if str(INFO) in self._place.sizes():
                raise DatasetError(
                    f"{self._url} has a dataset already, and {self._root} has no episode. Give another place"
                )
        else:
            bring(Index(self._root), self._place, progress=self._progress)
        self._copied = version
        self.tell(Status(self._episodes))

    def _version(self) -> object:
        """Return a value that changes with each episode. None if there is no episode."""
        with contextlib.suppress(FileNotFoundError):
            state = os.stat(self._root / INFO)
            return state.st_ino, state.st_mtime_ns, state.st_size
        return None

    def _progress(self, there: int, of: int) -> None:
        if there > self._episodes:
            self._episodes = there
            self.tell(Status(there))

    def tell(self, status: Status) -> None:
        if status != self._last_status:
            self._last_status = status
            # The recorder may have ended. The end of standard input then ends this process.
            with contextlib.suppress(BrokenPipeError):
                print(msgspec.json.encode(status).decode(), flush=True)

    def _close(self) -> None:
        place, self._place = self._place, None
        if place is not None:
            place.close()


def _ends_within(seconds: float) -> bool:
    """Wait. Return True as soon as standard input ends, which has no data."""
    until = time.monotonic() + seconds
    while (rest := until - time.monotonic()) > 0:
        if select.select([STDIN], [], [], rest)[0] and not os.read(STDIN, 100):
            return True
    return False


def main() -> int:
    """Copy the dataset in the folder ``argv[1]`` to the place ``argv[2]``. Return the exit code."""
    follow = Follow(Path(sys.argv[1]), sys.argv[2])
    try:
        return follow.run()
    except Exception as failure:  # The recorder shows it, and starts this process again.
        follow.tell(Status(problem=f"{type(failure).__name__}: {' '.join(str(failure).split())[:300]}"))
        raise


if __name__ == "__main__":
    sys.exit(main())

"""A recorder's process with stand-ins: cameras that show numbered pictures, and a disk of a given slowness."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import msgspec
import numpy as np
import trio
from numpy.typing import NDArray

from strands_actors.surfaces.dataset.child import _say
from strands_actors.surfaces.dataset.keys import read_words
from strands_actors.surfaces.dataset.order import Order
from strands_actors.surfaces.dataset.run import Summary, record_episodes
from strands_actors.surfaces.dataset.staging import FRAMES
from strands_actors.surfaces.dataset.storage import Storage

from .made import FRONT, scene


class Frame(msgspec.Struct, frozen=True):
    image: NDArray[np.uint8]
    captured_ns: int
    sequence: int


class Stale(msgspec.Struct, frozen=True):
    reason: str


class SceneCamera:
    """A camera that gives a numbered picture each 33 ms, except in the interval ``dark_s`` (from, to)."""

    def __init__(self, fps: float = 30.0, dark_s: tuple[float, float] = (0.0, 0.0)) -> None:
        self._period_ns = round(1e9 / fps)
        self._dark_s = dark_s
        self._began_ns = time.monotonic_ns()

    def newest(self) -> Frame | Stale:
        since_ns = time.monotonic_ns() - self._began_ns
        if self._dark_s[0] <= since_ns / 1e9 < self._dark_s[1]:
            return Stale("unplugged")
        number = since_ns // self._period_ns
        return Frame(scene(FRONT, number), self._began_ns + number * self._period_ns, number)

    def close(self) -> None:
        """Do nothing, because nothing is open."""


class SlowFile:
    """A file whose ``flush`` takes ``slow_s`` seconds."""

    def __init__(self, file: IO[bytes], slow_s: float) -> None:
        self._file = file
        self._slow_s = slow_s

    def flush(self) -> None:
        time.sleep(self._slow_s)
        self._file.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


class SlowStorage(Storage):
    """A disk that is slow for the files of a running episode."""

    def __init__(self, slow_s: float) -> None:
        self._slow_s = slow_s

    def create(self, path: Path) -> IO[bytes]:
        file = super().create(path)
        slow: Any = SlowFile(file, self._slow_s)
        return slow if path.name == FRAMES and self._slow_s else file


async def main() -> Summary:
    order = msgspec.json.decode(sys.argv[1], type=Order)
    slow_s = float(sys.argv[2])

    async def controls(command: Callable[[str], None]) -> None:
        await read_words(command, lambda: signal.raise_signal(signal.SIGINT))

    return await record_episodes(
        order, controls, _say, attach=lambda robot, camera: SceneCamera(), storage=SlowStorage(slow_s)
    )


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    print(msgspec.json.encode(trio.run(main)).decode(), flush=True)

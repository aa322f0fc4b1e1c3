"""A process that writes episodes and streams them to a second place until it is killed.

It prints the number of the process that copies, and then ``finished`` after each episode.
"""

from __future__ import annotations

import sys
from pathlib import Path

import trio

from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.second.follower import Follower

from .quick import begin_quick, fill_quick


def write(root: Path) -> None:
    dataset = Dataset(root)
    for number in range(1000):
        episode = begin_quick(dataset)
        fill_quick(episode, 5 + number % 7)
        episode.finish()
        print("finished", flush=True)
        dataset.commit(episode.folder)


async def main(root: str, url: str) -> None:
    follower = Follower(root, url, lambda text: print(text, flush=True))
    async with trio.open_nursery() as nursery:
        nursery.start_soon(follower.run)
        await follower.require_accepted()
        assert follower.process is not None
        print(f"process {follower.process.pid}", flush=True)
        await trio.to_thread.run_sync(write, Path(root))


if __name__ == "__main__":
    trio.run(main, *sys.argv[1:])

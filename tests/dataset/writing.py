"""A process that writes episodes until it is killed. It prints ``finished`` after each episode."""

from __future__ import annotations

import sys
from pathlib import Path

from strands_actors.surfaces.dataset.dataset import Dataset

from .made import begin, fill, row


def main() -> None:
    dataset = Dataset(Path(sys.argv[1]))
    for number in range(1000):
        episode = begin(dataset, "wave" if number % 3 else "put the cube down")
        fill(episode, [row(frame) for frame in range(20 + number % 7)])
        episode.finish()
        print("finished", flush=True)
        dataset.commit(episode.folder)


if __name__ == "__main__":
    main()

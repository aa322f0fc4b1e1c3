"""Write the running episode, and commit it when it is finished. Every method may wait for the disk."""

from __future__ import annotations

from .dataset import Dataset
from .episode import Episode
from .frames import BuiltFrame
from .layout import Layout
from .staging import StagedEpisode, new_folder


class EpisodeWriter:
    """Writes one episode after the other into a dataset."""

    def __init__(self, dataset: Dataset, task: str) -> None:
        self._dataset = dataset
        self._task = task
        self._episode: StagedEpisode | None = None

    def open(self, layout: Layout) -> None:
        """Begin an episode."""
        folder = new_folder(self._dataset.staging)
        self._episode = StagedEpisode(self._dataset.storage, folder, layout, self._task)

    def add(self, frame: BuiltFrame) -> None:
        assert self._episode is not None
        self._episode.add(frame.row, frame.pictures)

    def drop(self) -> None:
        """Remove the running episode."""
        self._remove(self._take())

    def save(self, gap: int) -> Episode | None:
        """Finish the running episode, and commit it.

        Args:
            gap: Number of missing frames after the last frame.

        Returns:
            The committed episode. None if it had no frames, so that it was removed.
        """
        episode = self._take()
        if not episode.frames:
            self._remove(episode)
            return None
        episode.finish(gap)
        return self._dataset.commit(episode.folder)

    def abandon(self) -> bool:
        """Close the files of the running episode, which stay on the disk. Return False if no episode runs."""
        if self._episode is None:
            return False
        self._episode.abandon()
        return True

    def _take(self) -> StagedEpisode:
        assert self._episode is not None
        episode, self._episode = self._episode, None
        return episode

    def _remove(self, episode: StagedEpisode) -> None:
        episode.abandon()
        self._dataset.storage.remove(episode.folder)

"""A dataset of the Hugging Face Hub as the second place. Each episode is one commit."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping
from typing import IO

from strands_actors.contract.extras import missing
from strands_actors.surfaces.dataset.errors import DatasetError

from .place import HUB, PlaceError, Source


class Hub:
    """A dataset of the Hub. It is created as a private dataset if it does not exist."""

    is_atomic = True

    def __init__(self, url: str) -> None:
        if reason := missing("hub", "a copy on the Hub"):
            raise DatasetError(reason)
        from huggingface_hub import HfApi

        self.url = url
        self._name = url.removeprefix(HUB).strip("/")
        self._api = HfApi()
        with self._reaching():
            self._api.create_repo(self._name, repo_type="dataset", private=True, exist_ok=True)

    def sizes(self) -> dict[str, int]:
        from huggingface_hub.hf_api import RepoFile

        with self._reaching():
            entries = self._api.list_repo_tree(self._name, repo_type="dataset", recursive=True)
            return {entry.path: entry.size for entry in entries if isinstance(entry, RepoFile)}

    @contextlib.contextmanager
    def open(self, name: str) -> Iterator[IO[bytes]]:
        # Into a folder of its own, because the client's cache would keep every file that is compared.
        with tempfile.TemporaryDirectory() as folder:
            with self._reaching():
                path = self._api.hf_hub_download(self._name, name, repo_type="dataset", local_dir=folder)
            with open(path, "rb") as file:
                yield file

    def put(self, files: Mapping[str, Source], note: str) -> None:
        from huggingface_hub import CommitOperationAdd

        operations = [
            CommitOperationAdd(path_in_repo=name, path_or_fileobj=source) for name, source in files.items()
        ]
        with self._reaching():
            self._api.create_commit(self._name, operations, commit_message=note, repo_type="dataset")

    def close(self) -> None:
        """Do nothing. The client keeps no connection that must be closed."""

    @contextlib.contextmanager
    def _reaching(self) -> Iterator[None]:
        from huggingface_hub.errors import HFValidationError

        try:
            yield
        except HFValidationError as wrong:
            raise DatasetError(f"{self.url}: {' '.join(str(wrong).split())[:300]}") from wrong
        except Exception as failure:  # Each version of the client has the errors of another HTTP library.
            text = " ".join(str(failure).split())[:300] or type(failure).__name__
            raise PlaceError(f"{self.url}: {text}") from failure

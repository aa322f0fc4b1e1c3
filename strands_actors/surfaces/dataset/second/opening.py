"""Open a second place by its URL."""

from __future__ import annotations

from pathlib import Path

from .hub import Hub
from .place import HUB, Folder, Objects, Place, require_url


def open_place(url: str, root: Path) -> Place:
    """Open the second place of the dataset in ``root``.

    Raises:
        DatasetError: The URL or an installed package does not allow it.
        PlaceError: The place cannot be used at the moment.
    """
    require_url(url, root)
    if url.startswith(HUB):
        return Hub(url)
    return Objects(url) if "://" in url else Folder(url)

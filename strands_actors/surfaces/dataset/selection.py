"""Choose episodes of a dataset by text: ``0-4,7``, ``good``, ``all``, or a share such as ``80%``. No I/O."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from strands_actors.contract.shown import shown

from .errors import DatasetError
from .index import Index

ALL, GOOD = "all", "good"
_SHARE = re.compile(r"(\d{1,3}(?:\.\d+)?)%")
_RANGE = re.compile(r"(\d{1,9})(?:-(\d{1,9}))?")


class Part(NamedTuple):
    """A part of a dataset: its folder, and its share as text."""

    folder: Path
    share: str


def is_share(text: str) -> bool:
    return text.endswith("%")


def numbers_in(index: Index, text: str, damaged: Collection[int] = ()) -> list[int]:
    """Return the numbers of the episodes that a text names, in order, each once.

    Args:
        index: The dataset.
        text: Numbers and ranges with commas between them; ``all``; ``good`` for the episodes without defects and
            marks.
        damaged: Episodes that are damaged.

    Raises:
        DatasetError: The text has another form, or an episode does not exist.
    """
    numbers: set[int] = set()
    for word in text.replace(" ", "").split(","):
        if word == ALL:
            numbers |= index.rows.keys()
        elif word == GOOD:
            numbers |= {
                each.index for each in index.episodes if not each.quality.as_text and each.index not in damaged
            }
        elif match := _RANGE.fullmatch(word):
            first, last = int(match[1]), int(match[2] or match[1])
            if last < first or last not in index.rows or first not in index.rows:
                raise DatasetError(
                    f"{index.root} has no episodes {word}. It has {len(index.rows)}, numbered from 0"
                )
            numbers |= set(range(first, last + 1))
        else:
            raise DatasetError(
                f"episodes {shown(word)} cannot be read. Write numbers such as 0-4,7, or good, or all"
            )
    return sorted(numbers)


def shares(numbers: Sequence[int], parts: Sequence[Part]) -> dict[Path, list[int]]:
    """Divide episodes by shares, in order. All parts together have the rounded sum of the shares.

    Raises:
        DatasetError: A part is no share, or the shares are more than 100 %.
    """
    by_part: dict[Path, list[int]] = {}
    percent = begin = 0.0
    for folder, share in parts:
        match = _SHARE.fullmatch(share)
        if match is None:
            raise DatasetError(f"{shown(share)} is no share. Give shares such as 80% for all parts, or for none")
        percent += float(match[1])
        end = round(len(numbers) * percent / 100)
        by_part[folder] = list(numbers[round(begin) : end])
        begin = end
    if percent > 100 + 1e-9:
        raise DatasetError(f"the shares are {percent:g} % together. Give 100 % or less")
    return by_part

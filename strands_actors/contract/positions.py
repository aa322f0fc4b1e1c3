"""Positions by joint name, as an observation contains them."""

from __future__ import annotations

from typing import Any

SUFFIX = ".pos"
"""The suffix of a joint's name in lerobot, and in policies for it."""


class Positions(dict[str, float]):
    """The positions of a robot, in the order of its axes.

    Both keys ``shoulder_pan`` and ``shoulder_pan.pos`` return the same value. Only the key without ``.pos`` is
    stored, shown and sent.
    """

    def __missing__(self, key: object) -> float:
        plain = _plain(key)
        if plain is None or not dict.__contains__(self, plain):
            raise KeyError(key)
        return dict.__getitem__(self, plain)

    def __contains__(self, key: object) -> bool:
        return dict.__contains__(self, key) or dict.__contains__(self, _plain(key))

    def get(self, key: object, default: Any = None) -> Any:
        """Return the position for a key, with or without ``.pos``; ``default`` if there is no such joint."""
        try:
            return self[key]  # type: ignore[index]  # any key may be asked for
        except KeyError:
            return default

    def copy(self) -> Positions:
        """Return a copy of the positions. It accepts keys with ``.pos``, too."""
        return Positions(self)


def _plain(key: object) -> str | None:
    """Return the key without its suffix ``.pos``, or None if it has no such suffix."""
    return key.removesuffix(SUFFIX) if isinstance(key, str) and key.endswith(SUFFIX) else None


__all__ = ["SUFFIX", "Positions"]

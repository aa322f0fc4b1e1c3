"""Packages that only some need: what is used of them, and the line that installs it."""

from __future__ import annotations

import importlib.util

EXTRAS: dict[str, tuple[str, ...]] = {
    "dataset": ("pyarrow", "av"),
    "cameras": ("cv2",),
    "demo": ("matplotlib",),
    "mcp": ("mcp",),
    "pictures": ("OpenGL", "glfw"),
    "reachy": ("aiortc",),
    "record": ("mcap", "zstandard"),
    "top": ("textual",),
}
"""By extra, the modules that it brings. ``pyproject.toml`` has the packages."""


class MissingExtra(ImportError):
    """An extra is not installed; the text has the line that installs it."""


def missing(extra: str, use: str) -> str:
    """Return why ``use`` cannot be, with the line that installs the extra; empty: it is there."""
    absent = [name for name in EXTRAS[extra] if importlib.util.find_spec(name) is None]
    if not absent:
        return ""
    return f"{use} needs {' and '.join(absent)}. pip install 'strands-actors[{extra}]'"


def require(extra: str, use: str) -> None:
    """Raise ``MissingExtra`` when ``use`` cannot be."""
    if why := missing(extra, use):
        raise MissingExtra(why)

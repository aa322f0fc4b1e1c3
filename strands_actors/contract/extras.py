"""Optional packages: the modules that each extra of this package installs, and the command that installs it."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import NoReturn

EXTRAS: dict[str, tuple[str, ...]] = {
    "dataset": ("pyarrow", "av"),
    "cameras": ("cv2",),
    "demo": ("matplotlib",),
    "foxglove": ("foxglove",),
    "hub": ("huggingface_hub",),
    "mcp": ("mcp",),
    "metrics": ("prometheus_client",),
    "otel": ("opentelemetry.sdk", "opentelemetry.exporter.otlp.proto.http"),
    "pictures": ("OpenGL", "glfw"),
    "reachy": ("aiortc",),
    "record": ("mcap", "zstandard"),
    "top": ("textual",),
    "web": ("hypercorn", "segno", "starlette"),
}
"""The modules of each extra. ``pyproject.toml`` has the packages."""


class MissingExtra(ImportError):
    """An extra (a set of optional packages) is not installed. The text has the command that installs it."""


def missing(extra: str, use: str) -> str:
    """Return why ``use`` is not possible, with the command that installs the extra (optional packages).

    Args:
        extra: One of ``EXTRAS``.
        use: The feature that needs the extra, which begins the sentence.

    Returns:
        One sentence; empty if the extra is installed.
    """
    absent = [name for name in EXTRAS[extra] if not _is_installed(name)]
    if not absent:
        return ""
    return f"{use} needs {' and '.join(absent)}. pip install 'strands-actors[{extra}]'"


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # A package around it is not installed.
        return False


def require(extra: str, use: str) -> None:
    """Raise ``MissingExtra`` if an extra that ``use`` needs is not installed."""
    if reason := missing(extra, use):
        raise MissingExtra(reason)


def refusing(name: str, failure: ImportError) -> Callable[..., NoReturn]:
    """Return a replacement for a function that needs an extra (optional packages) that is not installed.

    Args:
        name: The name of the function.
        failure: The exception that importing the function has raised. A call of the replacement raises
            ``MissingExtra`` with the text of this exception.
    """
    reason = str(failure) if isinstance(failure, MissingExtra) else f"{name} cannot be imported: {failure}"

    def refuse(*values: object, **keywords: object) -> NoReturn:
        raise MissingExtra(reason) from failure

    refuse.__name__ = refuse.__qualname__ = name
    refuse.__doc__ = f"Not installed: {reason}"
    return refuse

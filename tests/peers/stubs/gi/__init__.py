"""A stub of ``gi``. Reachy Mini's daemon imports it, but does not use it without media. The real package is
compiled against the system's GStreamer."""


def require_version(name: str, version: str) -> None:
    """Accept any version."""

"""What Reachy Mini's daemon imports and, without media, does not use. The real one is compiled
against the system's GStreamer."""


def require_version(name: str, version: str) -> None:
    """Any will do."""

"""The version of the package. ``pyproject.toml`` contains the same version."""

__version__ = "0.1.0"

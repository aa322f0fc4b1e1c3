"""Load objects by name at first use: ``module:qualified.name``."""

from __future__ import annotations

import importlib
from typing import Any


def place_of(thing: type[Any]) -> str:
    """Return the name under which ``load`` finds a class or function."""
    return f"{thing.__module__}:{thing.__qualname__}"


def load(object_path: str) -> Any:
    """Import the module and return the object at ``module:qualified.name``."""
    module, _, name = object_path.partition(":")
    loaded: Any = importlib.import_module(module)
    for part in name.split("."):
        loaded = getattr(loaded, part)
    return loaded

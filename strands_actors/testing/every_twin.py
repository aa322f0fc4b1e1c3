"""Import this, and everything is imported that the twins of this package import: a process forked
from one that has it does not load every driver to find its own, a quarter of a second of computing."""

from __future__ import annotations

import contextlib
from importlib import import_module

from .every_driver import CLASSES

for _class in CLASSES:
    with contextlib.suppress(ImportError):  # of an extra that is not installed: who wants this twin is told
        import_module(_class.TWIN.partition(":")[0])

"""Find the file and the module that define a driver class, so that other processes can import the class."""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import sys
from pathlib import Path
from typing import Any

import msgspec

SCRIPT = "strands_actors_script"
"""Module name under which another process imports the user's script. Code below ``__main__`` does not run then."""

_loading = False


class ClassLocation(msgspec.Struct, frozen=True):
    """Where another process can import a class from.

    Attributes:
        module: Name of the module. It is ``SCRIPT`` for a class that is defined in the user's script.
        name: Qualified name of the class.
        folder: The folder that must be in the import path.
        script: Path of the script that defines the class; empty for a module.
        digest: Hash of the file. A certificate of a stop drill is valid only for the code that was drilled.
    """

    module: str
    name: str
    folder: str
    script: str
    digest: str


def location_of_class(cls: type[Any]) -> ClassLocation:
    """Return where ``cls`` is defined.

    Raises:
        ValueError: Another process could not import the class.
    """
    name = cls.__qualname__
    if _loading:
        raise ValueError(
            f"Robot: the file of {name} calls Robot() while it is imported. Put the call below "
            "`if __name__ == '__main__':`"
        )
    if "<locals>" in name:
        raise ValueError(
            f"Robot: {name} is defined in a function, and another process cannot import it. Put the class at the "
            "top of a module"
        )
    module = sys.modules[cls.__module__]
    file = getattr(module, "__file__", None)
    if file is None:
        raise ValueError(
            f"Robot: {name} is in no file, and another process must import it. Put the class into a module"
        )
    path = Path(file).resolve()
    source = path.read_bytes()
    digest = hashlib.sha256(source).hexdigest()[:16]
    if cls.__module__ != "__main__":
        return ClassLocation(cls.__module__, name, str(_folder(path, cls.__module__)), "", digest)
    if not _is_guarded(source):
        raise ValueError(
            f"Robot: {name} is defined in {path.name}, and another process would run this script to import it. Put "
            "the class into a separate module, or the script's calls below `if __name__ == '__main__':`"
        )
    spec = getattr(module, "__spec__", None)
    if spec is not None:  # the script was started with ``python -m``
        return ClassLocation(spec.name, name, str(_folder(path, spec.name)), "", digest)
    return ClassLocation(SCRIPT, name, str(path.parent), str(path), digest)


def load_class(location: ClassLocation) -> type[Any]:
    """Import the class and return it.

    Raises:
        AttributeError: The module no longer has the class.
        Exception: The module raised an exception of any kind.
    """
    global _loading
    if location.folder not in sys.path:
        sys.path.append(location.folder)
    _loading = True
    try:
        module = _script(location.script) if location.script else importlib.import_module(location.module)
    finally:
        _loading = False
    member: Any = module
    for part in location.name.split("."):
        member = getattr(member, part)
    loaded: type[Any] = member
    return loaded


def _script(file: str) -> Any:
    if SCRIPT in sys.modules:
        return sys.modules[SCRIPT]
    spec = importlib.util.spec_from_file_location(SCRIPT, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[SCRIPT] = module  # dataclasses look up the module of their class here
    spec.loader.exec_module(module)
    return module


def _folder(path: Path, module: str) -> Path:
    """Return the folder that must be in the import path, for ``module`` with the file ``path``."""
    folder = path.parent.parent if path.name == "__init__.py" else path.parent
    for _ in range(module.count(".")):
        folder = folder.parent
    return folder


def _is_guarded(source: bytes) -> bool:
    """Return True if a script checks ``__name__`` at its top level."""
    return any(
        isinstance(node, ast.If)
        and isinstance(node.test, ast.Compare)
        and any(isinstance(name, ast.Name) and name.id == "__name__" for name in ast.walk(node.test))
        for node in ast.parse(source).body
    )

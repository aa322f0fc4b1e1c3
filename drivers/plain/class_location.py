"""Find out where a driver class is defined, so that the processes of its robot can import it."""

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
"""Module name under which another process loads a script. Code below ``__main__`` does not run there."""

_loading = False


class ClassLocation(msgspec.Struct, frozen=True):
    """Where another process can import a class from.

    ``folder``: the last entry of the import path for its module. ``script``: the file, if the class is
    defined in the script itself. ``digest``: hash of the file, since a stop drill counts only for the code
    that was drilled.
    """

    module: str
    name: str
    folder: str
    script: str
    digest: str


def location_of_class(cls: type[Any]) -> ClassLocation:
    """Return where ``cls`` is defined.

    Raises:
        ValueError: Another process cannot import it.
    """
    name = cls.__qualname__
    if _loading:
        raise ValueError(
            f"Robot: called while {name} is loaded in a process of its robot. Put the call below "
            "`if __name__ == '__main__':`"
        )
    if "<locals>" in name:
        raise ValueError(
            f"Robot: {name} is made within a function, where its process cannot find it. Put the class at the top "
            "of a module"
        )
    module = sys.modules[cls.__module__]
    file = getattr(module, "__file__", None)
    if file is None:
        raise ValueError(
            f"Robot: {name} stands in no file. Put it into a module: its robot has a process of its own"
        )
    path = Path(file).resolve()
    source = path.read_bytes()
    digest = hashlib.sha256(source).hexdigest()[:16]
    if cls.__module__ != "__main__":
        return ClassLocation(cls.__module__, name, str(_folder(path, cls.__module__)), "", digest)
    if not _is_guarded(source):
        raise ValueError(
            f"Robot: {name} stands in {path.name}, which its process would run as a whole. Put the class into a "
            "module of its own, or what the script does below `if __name__ == '__main__':`"
        )
    spec = getattr(module, "__spec__", None)
    if spec is not None:  # python -m
        return ClassLocation(spec.name, name, str(_folder(path, spec.name)), "", digest)
    return ClassLocation(SCRIPT, name, str(path.parent), str(path), digest)


def load_class(location: ClassLocation) -> type[Any]:
    """Import the class.

    Raises:
        AttributeError: The module no longer has the class.
        Exception: Any exception that the module raises.
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
    sys.modules[SCRIPT] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module


def _folder(path: Path, module: str) -> Path:
    """Return the folder from which ``module``, at ``path``, is imported by its name."""
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

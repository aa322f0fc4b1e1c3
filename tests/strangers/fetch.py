"""Fetch a client into the cache: an environment with its package, and its source distribution if its examples are
there. A client is fetched once; another version gets another folder."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import NamedTuple

from tests.lerobot.environments import interpreter

from .table import Client

WHERE = "STRANDS_ACTORS_STRANGERS"
"""The environment variable that names another folder than that of the user's cache."""
FETCH_S = 1200.0
MADE = "made"
"""The file that is written last, so that an interrupted installation is not taken for a whole one."""
UV = (sys.executable, "-m", "uv", "--quiet", "--no-config")
OURS = f"{sys.version_info[0]}.{sys.version_info[1]}"


class NotFetched(Exception):
    """The client cannot be had on this machine. The text has the reason."""


class Fetched(NamedTuple):
    """A client in the cache.

    Attributes:
        python: The interpreter of its environment.
        commands: The folder of the commands that it installs.
        examples: The folder of its examples, unmodified. None: it has no example programs.
        modules: The folder of npm's modules. None: it is a Python package.
    """

    python: Path
    commands: Path
    examples: Path | None = None
    modules: Path | None = None


def cache() -> Path:
    """Return the folder of all clients."""
    if where := os.environ.get(WHERE):
        return Path(where)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "strands-actors" / "strangers"


def fetch(client: Client, given: Path | None = None) -> Fetched:
    """Return a client from the cache. Fetch it if it is not there.

    Args:
        client: The row of the table.
        given: The folder of examples that a person has named. It is then the folder of the examples.

    Raises:
        NotFetched: A program or a Python version is missing, or the index does not have the package.
    """
    place = cache() / f"{client.pin.replace('/', '-')}-py{client.python or OURS}"
    if not (place / MADE).exists():
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        if client.index == "npm":
            _npm(client, place)
        else:
            _environment(client, place)
            if client.examples == "sdist":
                _source(client, place)
        (place / MADE).touch()
    if client.index == "npm":
        node = _program("node", "Node.js")
        return Fetched(node, place / "node_modules" / ".bin", modules=place / "node_modules")
    commands = place / "venv" / "bin"
    return Fetched(commands / "python", commands, _examples(client, place, given))


def _environment(client: Client, place: Path) -> None:
    python = interpreter(client.python or OURS)
    if python is None:
        raise NotFetched(f"it needs Python {client.python}, which is not installed")
    venv = place / "venv"
    _do(*UV, "venv", "--python", python, str(venv))
    install = (*UV, "pip", "install", "--python", str(venv / "bin" / "python"))
    _do(*install, *(("--no-deps",) if client.alone else ()), client.pin)
    if client.needs:
        _do(*install, *client.needs)
    for name in client.empty:
        (_site(venv) / f"{name}.py").write_text("")


def _source(client: Client, place: Path) -> None:
    archives = place / "archives"
    download = (sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps")
    _do(*download, "--no-binary", ":all:", "--dest", str(archives), client.pin)
    (archive,) = archives.iterdir()
    unpacked = place / "source"
    if archive.suffix == ".zip":
        with zipfile.ZipFile(archive) as packed:
            packed.extractall(unpacked)
    else:
        with tarfile.open(archive) as packed:
            packed.extractall(unpacked, filter="data")


def _npm(client: Client, place: Path) -> None:
    npm = _program("npm", "npm")
    _do(str(npm), "install", "--silent", "--ignore-scripts", "--prefix", str(place), client.pin)


def _program(name: str, title: str) -> Path:
    found = shutil.which(name)
    if found is None:
        raise NotFetched(f"it needs {title}, which is not installed")
    return Path(found)


def _site(venv: Path) -> Path:
    (site,) = venv.glob("lib/python*/site-packages")
    return site


def _examples(client: Client, place: Path, given: Path | None) -> Path | None:
    if given is not None:
        return given
    if client.examples == "wheel":
        return _site(place / "venv") / client.folder
    if client.examples == "sdist":
        (root,) = (place / "source").iterdir()
        return root / client.folder
    return None


def _do(*command: str) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=FETCH_S)
    except subprocess.TimeoutExpired:
        raise NotFetched(f"it could not be fetched within {FETCH_S:g} s") from None
    if done.returncode:
        lines = [line.strip() for line in (done.stderr or done.stdout).splitlines() if line.strip()]
        raise NotFetched(f"it could not be fetched: {' '.join(lines[-3:])}")


__all__ = ["WHERE", "Fetched", "NotFetched", "cache", "fetch"]

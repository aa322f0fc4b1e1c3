"""One environment for each version of LeRobot, made by pip, with this checkout in it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PLUGIN = ROOT / "plugins" / "lerobot_robot_strands_actors"
OURS = ("-e", f"{ROOT}[dataset,pictures]", "pytest>=8.3", "hypothesis>=6.120", "rustypot>=1.13,<2")
WHERE = "STRANDS_ACTORS_LEROBOT"
OPTION = "--lerobot"
"""``--lerobot 0.4.4``: that version alone, which need not be in ``VERSIONS``. Other arguments are pytest's."""


class Version(NamedTuple):
    lerobot: str
    python: str
    extras: str  # what its commands, and its buses, need


VERSIONS = (
    Version("0.4.4", "3.11", "feetech,dynamixel,smolvla"),
    Version("0.6.1", "3.12", "core-scripts,training,feetech,dynamixel,smolvla,openarms,robstride,rebot"),
)
"""The versions that were tried, the oldest first. The bounds of the distributions are the first and the last."""


def main(arguments: list[str]) -> int:
    """Make what is missing, run the tests in each; the first exit code that is not 0."""
    try:
        wanted, rest = split(arguments)
    except ValueError as error:
        print(error)
        return 2
    codes = [_run(version, rest) for version in [version_of(name) for name in wanted] or VERSIONS]
    return next((code for code in codes if code), 0)


def split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the versions of LeRobot that the arguments name, and the arguments for pytest.

    Raises:
        ValueError: A version is missing or is no version.
    """
    wanted, rest = list[str](), list[str]()
    remaining = iter(arguments)
    for argument in remaining:
        name, equals, value = argument.partition("=")
        if name != OPTION:
            rest.append(argument)
            continue
        version = value if equals else next(remaining, "")
        if not re.fullmatch(r"\d+(\.\w+)+", version):
            raise ValueError(f"{OPTION} is {version!r}, which is no version. Give one, such as {OPTION} 0.6.1")
        wanted.append(version)
    return wanted, rest


def version_of(name: str) -> Version:
    """Return how a version of LeRobot is installed. A version that is not in ``VERSIONS`` is installed like the
    newest one there."""
    known = next((version for version in VERSIONS if version.lerobot == name), None)
    return VERSIONS[-1]._replace(lerobot=name) if known is None else known


def _run(version: Version, arguments: list[str]) -> int:
    environment = folder() / version.lerobot
    python = str(environment / "bin" / "python")
    done = environment / "strands-actors"
    lerobot = f"lerobot[{version.extras}]=={version.lerobot}"
    made_of = " ".join((lerobot, *OURS))
    if not done.exists() or done.read_text() != made_of:
        found = interpreter(version.python)
        if found is None:
            print(f"lerobot {version.lerobot} needs Python {version.python}, and there is none here")
            return 2
        _do(found, "-m", "venv", str(environment))
        _do(python, "-m", "pip", "install", lerobot)
        _do(python, "-m", "pip", "install", *OURS)
        done.write_text(made_of)
    # Not editable: LeRobot has to find it as it finds what people install. Without its dependencies, because a
    # version that is tried for the first time is beyond its bounds.
    _do(python, "-m", "pip", "install", "-q", "--no-deps", "--force-reinstall", str(PLUGIN))
    print(f"$ lerobot {version.lerobot}, Python {version.python}", flush=True)
    which = [] if _names_a_test(arguments) else [str(Path(__file__).parent)]
    selected = [] if "-m" in arguments else ["-m", "not long"]
    command = [python, "-m", "pytest", "-p", "no:cacheprovider", *selected, *arguments, *which]
    return subprocess.run(command, cwd=ROOT).returncode


def _names_a_test(arguments: list[str]) -> bool:
    """Whether one is a file or folder of tests; else those of this folder are meant."""
    return any((ROOT / argument.partition("::")[0]).exists() for argument in arguments)


def folder() -> Path:
    """Return where the environments are. Several gigabytes each."""
    return Path(os.environ.get(WHERE) or Path("~/.cache/strands-actors/lerobot").expanduser())


def interpreter(minor: str) -> str | None:
    """Return a Python of this version that runs: ours, one on the path, or pyenv's newest."""
    if sys.version_info[:2] == tuple(map(int, minor.split("."))):
        return sys.executable
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path("~/.pyenv").expanduser())
    of_pyenv = sorted(pyenv.glob(f"versions/{minor}.*/bin/python"), key=_patch, reverse=True)
    on_path = shutil.which(f"python{minor}")
    found = [*([on_path] if on_path else []), *map(str, of_pyenv)]
    return next((python for python in found if _runs(python, minor)), None)


def _patch(python: Path) -> int:
    """Return the 12 of ``versions/3.11.12/bin/python``; of no release (``3.13.0rc1``) -1."""
    patch = python.parents[1].name.split(".")[2]
    return int(patch) if patch.isdigit() else -1


def _runs(python: str, minor: str) -> bool:
    """Ask it. A shim of pyenv's is on the path for each version there is, and refuses to run those
    that are not chosen."""
    ask = "import sys; print('%d.%d' % sys.version_info[:2])"
    done = subprocess.run([python, "-c", ask], capture_output=True, text=True)
    return done.returncode == 0 and done.stdout.strip() == minor


def _do(*command: str) -> None:
    print("$", *command, flush=True)
    subprocess.run(command, check=True)

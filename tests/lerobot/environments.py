"""One environment for each version of LeRobot, made by pip, with this checkout in it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PLUGIN = ROOT / "plugins" / "lerobot_robot_strands_actors"
OURS = f"{ROOT}[dataset,pictures]"
WHERE = "STRANDS_ACTORS_LEROBOT"
ONLY = "--only="
"""``--only=0.4.4``: that version alone. Other arguments are pytest's."""


class Version(NamedTuple):
    lerobot: str
    python: str
    extras: str  # what its commands, and its buses, need


VERSIONS = (
    Version("0.4.4", "3.11", "feetech,dynamixel,smolvla"),
    Version("0.6.1", "3.12", "core-scripts,training,feetech,dynamixel,smolvla"),
)


def main(arguments: list[str]) -> int:
    """Make what is missing, run the tests in each; the first exit code that is not 0."""
    only = [text.removeprefix(ONLY) for text in arguments if text.startswith(ONLY)]
    versions = [version for version in VERSIONS if not only or version.lerobot in only]
    if not versions:
        print(f"no version {', '.join(only)}. There are {', '.join(each.lerobot for each in VERSIONS)}")
        return 2
    rest = [text for text in arguments if not text.startswith(ONLY)]
    codes = [_run(version, rest) for version in versions]
    return next((code for code in codes if code), 0)


def _run(version: Version, arguments: list[str]) -> int:
    environment = folder() / version.lerobot
    python = str(environment / "bin" / "python")
    done = environment / "strands-actors"
    lerobot = f"lerobot[{version.extras}]=={version.lerobot}"
    made_of = f"{lerobot} {OURS}"
    if not done.exists() or done.read_text() != made_of:
        found = interpreter(version.python)
        if found is None:
            print(f"lerobot {version.lerobot} needs Python {version.python}, and there is none here")
            return 2
        _do(found, "-m", "venv", str(environment))
        _do(python, "-m", "pip", "install", lerobot)
        _do(python, "-m", "pip", "install", "-e", OURS, "pytest>=8.3", "hypothesis>=6.120")
        done.write_text(made_of)
    # Not editable: LeRobot has to find it as it finds what people install.
    _do(python, "-m", "pip", "install", "-q", "--no-deps", "--force-reinstall", str(PLUGIN))
    print(f"$ lerobot {version.lerobot}, Python {version.python}", flush=True)
    which = [] if _names_a_test(arguments) else [str(Path(__file__).parent)]
    command = [python, "-m", "pytest", "-p", "no:cacheprovider", *arguments, *which]
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

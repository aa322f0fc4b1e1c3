"""Run third-party clients that cannot be installed next to our dependencies.

Their module has the name of another package, or they need other versions. Each package is downloaded once,
checked against a hash, and kept next to the interpreter. A program that uses it runs in a separate process with
this package first on its path.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

KEPT = Path(sys.prefix) / "share" / "strands-actors"

URX = {
    "urx==0.11.0": "sha256:8ccfb101ec2c424bbbf8c7550819c2d6d9dbaaa693580d55187f0c4e0f900b82",
    "math3d==4.0.0": "sha256:83df636403c97a995fe4e422f34cb1561b44cfbe7aa19350143eb6e0247286c9",
}
"""LGPL and GPL, so never imported in this process. Their plotting dependencies are left out."""

FTSERVO = {
    "ftservo-python-sdk==2.0.1": "sha256:4d1ae104f1b34f845aaf8483386af0c00bbb83dc3cd33f692ca3200d4d780271",
}
"""Its module has the same name as that of feetech-servo-sdk."""


UNITREE = {
    "unitree-sdk2py-dimos==1.0.3": "sha256:8057cad5de5877757bc586b2ba5ddbe84522ce4c8c3d624464ef975cafa5daec",
    "cyclonedds==11.0.1": " --hash=".join(
        (
            "sha256:dce635041d42e954a5fec187dabf99d4b36c9daa54cc97d6d2238985e3ef6101",  # Python 3.11
            "sha256:3e96507088c57165f7c189c3a85be866f74c7449fb0cbc6316ad306e5f599be1",  # 3.12
            "sha256:fef1f6ce115a579e322f3156842e8b660883e4e8b0aa2f5e2a3df9d7959d1736",  # 3.13
        )
    ),
}
"""Unitree's own client (unitree_sdk2py, BSD), as a third party publishes it. The vendor's version needs
cyclonedds 0.10.2, which has no wheels for our interpreters. This one accepts any version."""


def run_with(packages: Mapping[str, str], program: str, *arguments: str, timeout_s: float = 120.0) -> str:
    """Run a program with these packages first on its path, and return its output.

    Raises:
        AssertionError: The program failed. The text is its whole output.
        RuntimeError: A package is not available.
    """
    command, environment = _command(packages, program, *arguments)
    ran = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, env=environment)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


@contextlib.contextmanager
def running_with(packages: Mapping[str, str], program: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run a program with these packages first on its path, its output a pipe. Kill it at the end.

    Raises:
        RuntimeError: A package is not available.
    """
    command, environment = _command(packages, program, *arguments)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        try:
            yield process
        finally:
            process.kill()


def _command(packages: Mapping[str, str], program: str, *arguments: str) -> tuple[list[str], dict[str, str]]:
    path = os.pathsep.join([str(_directory(packages)), os.environ.get("PYTHONPATH", "")])
    return [sys.executable, "-W", "ignore", "-c", program, *arguments], {**os.environ, "PYTHONPATH": path}


def _directory(packages: Mapping[str, str]) -> Path:
    kept = KEPT / next(iter(packages))
    if kept.exists():
        return kept
    kept.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=kept.parent) as directory:
        wanted, new = Path(directory) / "requirements.txt", Path(directory) / "packages"
        wanted.write_text("".join(f"{release} --hash={hashed}\n" for release, hashed in packages.items()))
        install = [sys.executable, "-m", "uv", "--quiet", "--no-config", "pip", "install", "--no-deps"]
        command = [*install, "--require-hashes", "--target", str(new), "-r", str(wanted)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"cannot fetch {', '.join(packages)}, clients of others: {done.stderr.strip()}")
        try:
            new.rename(kept)
        except OSError:  # another test has already done it
            shutil.rmtree(new)
    return kept

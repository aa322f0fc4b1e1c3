"""CycloneDDS's C library from the package that Unitree's users install: cyclonedds 0.10.2.

That package has wheels up to Python 3.10 only, but its library needs no Python. It is downloaded once by pip,
checked against a hash, and kept next to the interpreter. ``STRANDS_ACTORS_LIBDDSC`` names another library to
use instead.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

RELEASE = "cyclonedds==0.10.2"
HASH = "sha256:1194b03377e7644c7fb7230dd19b85eb363699d179459bdc5486974ec8d0fc0e"
MEMBER = "cyclonedds/.libs/libddsc.so"
KEPT = Path(sys.prefix) / "share" / "strands-actors" / "cyclonedds-0.10.2" / "libddsc.so"


def library() -> Path:
    """Return the library's path.

    Raises:
        RuntimeError: It is not available.
    """
    if given := os.environ.get("STRANDS_ACTORS_LIBDDSC"):
        return Path(given)
    if not KEPT.exists():
        with tempfile.TemporaryDirectory() as directory:
            content = _fetch(Path(directory))
        KEPT.parent.mkdir(parents=True, exist_ok=True)
        new = KEPT.with_suffix(f".{os.getpid()}")
        new.write_bytes(content)
        new.rename(KEPT)
    return KEPT


def _fetch(directory: Path) -> bytes:
    wanted = directory / "requirements.txt"
    wanted.write_text(f"{RELEASE} --hash={HASH}\n")
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--require-hashes", "-r", str(wanted)]
    command += ["--only-binary", ":all:", "--python-version", "3.10", "--implementation", "cp", "--abi", "cp310"]
    command += ["--platform", "manylinux_2_17_x86_64", "-d", str(directory)]
    done = subprocess.run(command, capture_output=True, text=True)
    wheels = list(directory.glob("*.whl"))
    if done.returncode or not wheels:
        raise RuntimeError(
            f"cannot fetch {RELEASE}, the other end of the RTPS tests, from the package index: "
            f"{done.stderr.strip()}\nOr give a libddsc of CycloneDDS 0.10: STRANDS_ACTORS_LIBDDSC=/usr/lib/..."
        )
    with zipfile.ZipFile(wheels[0]) as wheel:
        return wheel.read(MEMBER)

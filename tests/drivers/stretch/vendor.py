"""The vendor's client in a separate environment, which is made once and kept in the user's cache.

It is LGPL, and its listed dependencies cannot be installed together with other packages.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

CLIENT = "hello-robot-stretch-body==0.7.31"
NEEDS = (
    "numpy", "pyserial", "aioserial", "pyyaml", "click", "colorama", "filelock", "psutil", "opencv-python-headless",
    "dynamixel-sdk==4.1.0", "chime", "urchin", "meshio",
)  # fmt: skip
"""The packages that its modules import. Its own list also has audio, point clouds and a camera's SDK."""
NOT_THERE = ("pyrealsense2",)
"""An empty module: one of the client's modules imports it, but these tests do not need it."""
MADE_S = 600.0


def environment() -> Path:
    """Return the Python of the client's environment."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    root = cache / "strands-actors-tests" / f"{CLIENT.replace('==', '-')}-{sys.version_info[1]}"
    python = root / "bin" / "python"
    if not (root / "made").exists():
        uv = [sys.executable, "-m", "uv", "--quiet", "--no-config"]
        subprocess.run([*uv, "venv", "--clear", "--python", sys.executable, str(root)], check=True, timeout=MADE_S)
        install = [*uv, "pip", "install", "--python", str(python)]
        subprocess.run([*install, "--no-deps", CLIENT], check=True, timeout=MADE_S)
        subprocess.run([*install, *NEEDS], check=True, timeout=MADE_S)
        (site,) = root.glob("lib/python*/site-packages")
        for name in NOT_THERE:
            (site / f"{name}.py").write_text("")
        (root / "made").touch()
    return python

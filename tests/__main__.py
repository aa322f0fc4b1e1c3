"""``python -m tests``: style, types, tests (two at a time: most of them wait for processes); stops at the first
that fails. Arguments go to pytest."""

from __future__ import annotations

import subprocess
import sys

STEPS = (
    ("ruff", "check", "."),
    ("ruff", "format", "--check", "."),
    ("mypy",),
    ("pytest", "-n", "2", "--dist", "worksteal", *sys.argv[1:]),
)

for step in STEPS:
    print("$", *step, flush=True)
    code = subprocess.run([sys.executable, "-m", *step]).returncode
    if code:
        sys.exit(code)

"""The program in Erlang for a question: run ``erlang_peer.escript``, which is compiled when it starts."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

from benchmarks.house import Figures

_SCRIPT = Path(__file__).with_name("erlang_peer.escript")


def erlang(workload: str, short: bool) -> Figures:
    """Run one measurement of ``erlang_peer.escript``, and return its figures. Raise ``RuntimeError`` if Erlang is
    missing or fails.
    """
    if shutil.which("escript") is None:
        raise RuntimeError("Erlang is not installed: apt-get install erlang-base")
    command = ["escript", str(_SCRIPT), workload, *(["short"] if short else [])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with code {done.returncode}:\n{done.stderr}{done.stdout}")
    figures: Figures = json.loads(done.stdout.strip().splitlines()[-1])
    return figures

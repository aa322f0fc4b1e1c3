"""The last section of docs/guide/first-arm.md runs as it stands there: record with a camera, train five steps, and
run the policy on the twin."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

from tests.guide.blocks import agrees, announced, blocks_of

from .commands import ROOT, RUN_S, run

PAGE = ROOT / "docs" / "guide" / "first-arm.md"
BEFORE = "import time\nfrom strands_actors import Robot, record_dataset\n"
"""Names that the page has from its earlier blocks."""
TRAIN = "lerobot-train"


def test_what_the_page_records_is_trained_on_and_drives_the_twin(tmp_path: Path) -> None:
    *_, record, install, policy = blocks_of(PAGE)
    assert (record.language, install.language, policy.needs_lerobot) == ("python", "sh", True)
    script(record.source, tmp_path)
    (command,) = [words for line in lines(install.source) if (words := shlex.split(line))[0] == TRAIN]
    code, output = run(TRAIN.removeprefix("lerobot-"), tmp_path, *command[1:])
    assert code == 0, output
    assert "5/5" in output or "step:5" in output, output
    cameras = record.source.splitlines()[0]
    printed = script(f"{cameras}\n{policy.source}", tmp_path)
    assert agrees("\n".join(announced(policy.source)), printed), printed


def lines(source: str) -> list[str]:
    return source.replace("\\\n", " ").splitlines()


def script(source: str, folder: Path) -> str:
    """Run the source as a script in a folder. Return what it prints."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", BEFORE + source],
        env=environment,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=RUN_S,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout

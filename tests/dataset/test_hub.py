"""Copies on the Hub, by the real client and a stand-in for the server. The Hub itself was not tried."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from .hub_stand_in import Hub, serving
from .quick import grown

PATIENCE_S = 120.0


def copied(root: Path, address: str, *arguments: str) -> tuple[int, Any, str]:
    """Copy in another process, because the client reads the address of the Hub when it is imported."""
    home = str(root.parent / "hf")
    settings = {"HF_ENDPOINT": address, "HF_TOKEN": "hf_test", "HF_HOME": home, "HF_HUB_DISABLE_XET": "1"}
    environment = {**os.environ, **settings, "HF_HUB_OFFLINE": "0", "HF_HUB_DISABLE_TELEMETRY": "1"}
    done = subprocess.run(
        [sys.executable, "-c", "from strands_actors.surfaces.cli import main; main()", "dataset", "copy", str(root),
         "hf://datasets/me/pick", "--json", *arguments],
        env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    return done.returncode, json.loads(done.stdout or "null"), done.stderr


def test_each_episode_is_one_commit_and_what_is_missing_is_added(tmp_path: Path) -> None:
    root = grown(tmp_path / "set", 2)
    hub = Hub()
    with serving(hub) as address:
        code, said, errors = copied(root, address)
        assert code == 0, errors
        assert (said["episodes"], said["copied"]) == (2, 2)
        assert hub.commits == ["Add episode 0", "Add episode 1"] and all(hub.private)
        assert hub.files == {
            str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()
        }
        grown(root)
        hub.fails = 20
        code, _, errors = copied(root, address)
        assert code == 1 and "dataset copy: hf://datasets/me/pick: " in errors and errors.count("\n") == 1, errors
        hub.fails = 0
        name = "data/chunk-000/file-000.parquet"
        hub.files[name] = b"x" * len(hub.files[name])
        code, said, errors = copied(root, address, "--verify")
        assert code == 0 and said["copied"] == 2, errors
        assert hub.commits[2:] == ["Restore episode 0", "Add episode 2"]
        assert hub.files == {
            str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()
        }

"""The directory of pictures."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from strands_actors.caller.processes.run_directory import run_dir as own_dir
from strands_actors.surfaces.cameras import picture_files


def test_a_name_that_another_user_has_taken_is_passed_by(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Any user may make a directory in ``/dev/shm``, also one with our name."""
    ours = picture_files.pictures_dir(make=True)
    assert ours != own_dir()
    ours.rmdir()
    ours.mkdir(mode=0o700)
    lstat = Path.lstat

    def foreign(path: Path) -> os.stat_result:
        status = lstat(path)
        return os.stat_result((*status[:4], status.st_uid + 1, *status[5:10])) if path == ours else status

    monkeypatch.setattr(Path, "lstat", foreign)
    assert picture_files.pictures_dir(make=True) == own_dir()
    monkeypatch.undo()
    ours.rmdir()

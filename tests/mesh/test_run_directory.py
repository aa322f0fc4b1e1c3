"""The default run directory of a user. It is below a folder to which other users write, too."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from strands_actors.caller.processes.run_directory import run_dir


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that all users may write to, as /tmp."""
    monkeypatch.delenv("STRANDS_ACTORS_RUN")
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    monkeypatch.setattr(tempfile, "tempdir", str(shared))
    return shared


def test_the_default_run_directory_is_made_once_and_used_again(shared: Path) -> None:
    path = run_dir()
    assert path.parent == shared and path.stat().st_mode & 0o777 == 0o700
    assert run_dir() == path


def test_saf_017_a_link_made_by_another_user_is_not_followed(shared: Path, tmp_path: Path) -> None:
    """Otherwise sockets and notes would be written to a directory that another user chose, and to another one when
    the link changes."""
    mine = tmp_path / "mine"
    mine.mkdir(mode=0o700)
    path = run_dir()
    path.rmdir()
    path.symlink_to(mine)
    with pytest.raises(
        PermissionError, match=r"is a link: somebody else may have put it there.*STRANDS_ACTORS_RUN"
    ):
        run_dir()
    path.unlink()
    path.symlink_to(shared / "nowhere")
    with pytest.raises(PermissionError, match="is a link"):
        run_dir()
    assert list(mine.iterdir()) == []


def test_a_directory_that_others_may_enter_or_rename_is_refused(shared: Path) -> None:
    run_dir().chmod(0o755)
    with pytest.raises(PermissionError, match="open to others"):
        run_dir()
    run_dir_of_all = shared
    run_dir_of_all.chmod(0o777)
    with pytest.raises(PermissionError, match="lets others rename"):
        run_dir()


def test_a_file_in_place_of_the_directory_is_refused(shared: Path) -> None:
    path = run_dir()
    path.rmdir()
    path.write_text("")
    with pytest.raises(PermissionError, match="cannot be opened"):
        run_dir()


def test_a_run_directory_that_the_user_chose_may_be_a_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The user has chosen this directory."""
    mine = tmp_path / "mine"
    mine.mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(mine)
    monkeypatch.setenv("STRANDS_ACTORS_RUN", str(tmp_path / "link"))
    assert run_dir() == tmp_path / "link"

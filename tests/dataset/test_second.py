"""Finished episodes are copied to a second place: complete, in order, once, and without waiting for it."""

from __future__ import annotations

import contextlib
import errno
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import pytest

from strands_actors.surfaces import cli
from strands_actors.surfaces.dataset.errors import DamagedError, DatasetError
from strands_actors.surfaces.dataset.index import Index
from strands_actors.surfaces.dataset.second.bring import bring, copy_all
from strands_actors.surfaces.dataset.second.opening import open_place
from strands_actors.surfaces.dataset.second.place import Folder, Place, PlaceError, require_url
from strands_actors.surfaces.dataset.show import show
from strands_actors.surfaces.dataset.storage import Lock, Storage

from .buckets import bucket
from .made import info_of
from .quick import files_of, grown

INFO = "meta/info.json"


@pytest.fixture(scope="module")
def bucket_url() -> Iterator[str]:
    with bucket("pick") as url:
        yield url


@pytest.fixture(params=["folder", pytest.param("s3", marks=pytest.mark.long)])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "folder":
        return str(tmp_path / "second")
    return f"{request.getfixturevalue('bucket_url')}/{tmp_path.name}"


@contextlib.contextmanager
def opened(url: str, root: Path) -> Iterator[Place]:
    place = open_place(url, root)
    try:
        yield place
    finally:
        place.close()


def copied(root: Path, url: str, verify: bool = False) -> tuple[int, int]:
    """Return how many episodes the place has, and how many were copied now."""
    with opened(url, root) as place:
        done = copy_all(root, place, verify, lambda there, of: None)
        assert not done.uncounted
        return done.episodes, done.copied


def contents(place: Place) -> dict[str, bytes]:
    found = {}
    for name in place.sizes():
        with place.open(name) as file:
            found[name] = file.read()
    return found


def downloaded(url: str, root: Path, into: Path) -> Path:
    """Return the second place as a folder."""
    with opened(url, root) as place:
        for name, data in contents(place).items():
            (into / name).parent.mkdir(parents=True, exist_ok=True)
            (into / name).write_bytes(data)
    return into


def test_a_place_gets_each_episode_once_and_is_a_dataset(tmp_path: Path, url: str) -> None:
    root = grown(tmp_path / "set", 2)
    assert copied(root, url) == (2, 2)
    assert copied(root, url) == (2, 0)
    grown(root)
    assert copied(root, url, verify=True) == (3, 1)
    with opened(url, root) as place:
        assert contents(place) == files_of(root)
    back = downloaded(url, root, tmp_path / "back")
    assert show(back).good == [0, 1, 2] and not show(back).faults


def test_a_file_that_changed_there_is_found_and_replaced(tmp_path: Path, url: str) -> None:
    root = grown(tmp_path / "set", 3)
    copied(root, url)
    name = "data/chunk-000/file-001.parquet"
    size = (root / name).stat().st_size
    with opened(url, root) as place:
        place.put({name: b"x" * size, "meta/stats.json": b"{}"}, "")
    assert copied(root, url) == (3, 0), "sizes are equal"
    assert copied(root, url, verify=True) == (3, 1)
    with opened(url, root) as place:
        assert contents(place) == files_of(root)


def test_another_dataset_is_refused_and_nothing_is_written(tmp_path: Path, url: str) -> None:
    first, second = grown(tmp_path / "set", 2), grown(tmp_path / "strange", 3, frames=7)
    copied(first, url)
    with opened(url, first) as place:
        before = contents(place)
    with pytest.raises(DatasetError, match=r"has another dataset than .*: its episode . is another one"):
        copied(second, url)
    with pytest.raises(DatasetError, match=r"has another dataset than .*: it has 2 episodes, and .* has 1"):
        copied(grown(tmp_path / "small"), url)
    info = info_of(first)
    info["robot_type"] = "strands_koch"
    with opened(url, first) as place:
        place.put({INFO: json.dumps(info).encode()}, "")
        with pytest.raises(DatasetError, match="it is of the robot strands_koch, not strands_so101"):
            bring(Index(first), place)
        place.put({INFO: b'{"codebase'}, "")
        with pytest.raises(DatasetError, match=r"info.json is damaged"):
            bring(Index(first), place)
        assert contents(place).keys() == before.keys()


def test_files_of_another_dataset_without_its_info_are_not_added_to(tmp_path: Path) -> None:
    second = tmp_path / "second"
    (second / "data/chunk-000").mkdir(parents=True)
    (second / "data/chunk-000/file-007.parquet").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"has no meta/info.json, but files of another dataset: .*file-007"):
        copied(grown(tmp_path / "set"), str(second))


def test_a_damaged_dataset_is_not_copied(tmp_path: Path, url: str) -> None:
    root = grown(tmp_path / "set", 2)
    data = root / "data/chunk-000/file-001.parquet"
    data.write_bytes(data.read_bytes()[:-30])
    with pytest.raises(DamagedError, match="episode 1 is damaged"):
        copied(root, url)
    with opened(url, root) as place:
        assert not place.sizes()


class FullDisk(Storage):
    """A disk that takes so many files, and then fails in the middle of one."""

    def __init__(self, files: int, error: int = errno.ENOSPC) -> None:
        self.files = files
        self._error = error

    def create(self, path: Path) -> IO[bytes]:
        self.files -= 1
        if self.files < 0:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(b"half")
            raise OSError(self._error, os.strerror(self._error))
        return super().create(path)


@pytest.mark.parametrize("files", [0, 2, 5, 6, 9, 11])
def test_a_full_disk_is_named_and_has_only_complete_episodes(tmp_path: Path, files: int) -> None:
    root, second = grown(tmp_path / "set", 2), tmp_path / "second"
    place = Folder(str(second), FullDisk(files))
    with pytest.raises(PlaceError, match="second: No space left on device"):
        bring(Index(root), place)
    place.close()
    there = show(second).total_episodes if (second / INFO).exists() else 0
    assert there == (files >= 6) and not (second / ".staging").exists()
    assert copied(root, str(second)) == (2, 2 - there)
    assert files_of(second) == files_of(root)


def test_a_read_only_disk_and_a_missing_one_are_named(tmp_path: Path) -> None:
    root = grown(tmp_path / "set")
    place = Folder(str(tmp_path / "second"), FullDisk(0, errno.EROFS))
    with pytest.raises(PlaceError, match="second: Read-only file system"):
        bring(Index(root), place)
    place.close()
    with pytest.raises(PlaceError, match=r"there is no folder .*usb. Mount its disk"):
        open_place(str(tmp_path / "usb" / "set"), root)


def test_a_place_that_goes_away_is_not_replaced_by_a_new_folder(tmp_path: Path) -> None:
    root, second = grown(tmp_path / "set"), tmp_path / "second"
    with opened(str(second), root) as place:
        bring(Index(root), place)
        second.rename(tmp_path / "unmounted")
        grown(root)
        with pytest.raises(PlaceError, match="was moved, or its disk was unmounted"):
            bring(Index(root), place)
    assert not second.exists() and show(tmp_path / "unmounted").good == [0]


def test_two_processes_do_not_copy_at_once(tmp_path: Path) -> None:
    root = grown(tmp_path / "set")
    with opened(str(tmp_path / "second"), root):
        with pytest.raises(PlaceError, match="another process writes into"):
            open_place(str(tmp_path / "second"), root)
        with opened(str(tmp_path / "third"), root) as place:
            lock = Lock(root / "meta")
            with pytest.raises(PlaceError, match="another process copies"):
                bring(Index(root), place)
            lock.release()


def test_a_bucket_that_does_not_exist_or_answer_is_named(tmp_path: Path, bucket_url: str) -> None:
    root = grown(tmp_path / "set")
    with (
        opened("s3://nobody/set", root) as place,
        pytest.raises(PlaceError, match=r"s3://nobody/set: .*does not exist"),
    ):
        bring(Index(root), place)


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("ftp://host/set", "copies to 'ftp' are not supported"),
        ("s3://", "names no folder"),
        ("s3://key:secret@bucket/set", "has a key in its URL"),
        ("hf://models/me/x", "is not a dataset of the Hub. Write hf://datasets/USER/NAME"),
        ("hf://datasets/me", "is not a dataset of the Hub"),
        ("set", "is the dataset's own folder"),
        ("set/copy", "is the dataset's own folder"),
        (".", "is the dataset's own folder"),
        ("fsspec+nothing://bucket/set", "cannot be used"),
    ],
)
def test_a_url_that_cannot_be_used_is_refused(
    url: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.run(("dataset", "copy", "set", url)) == cli.USAGE
    output = capsys.readouterr().err
    assert says in output and output.count("\n") == 1, output
    if not url.startswith("fsspec"):
        with pytest.raises(DatasetError):
            require_url(url, Path("set"))


def test_the_command_copies_and_verifies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, second = grown(tmp_path / "set", 2), tmp_path / "second"

    def run(*arguments: str) -> tuple[int, Any]:
        code = cli.run(("dataset", "copy", str(root), str(second), *arguments, "--json"))
        return code, json.loads(capsys.readouterr().out or "null")

    code, done = run()
    assert code == 0 and (done["episodes"], done["of"], done["copied"]) == (2, 2, 2)
    assert run("--verify")[1]["copied"] == 0
    (second / "data/chunk-000/file-009.parquet").write_bytes(b"")
    assert run()[1]["uncounted"] == ["data/chunk-000/file-009.parquet"]
    second.rename(tmp_path / "other")
    second.write_text("a file")
    assert run()[0] == 1

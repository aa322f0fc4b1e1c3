"""Poses that a person stores in the console."""

from __future__ import annotations

from pathlib import Path

import pytest

from strands_actors.surfaces.web.poses import MAX_NAME, MOST_POSES, BadPoses, Poses

JOINTS = {"pan": 1.5, "lift": -2.0}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "console" / "poses.json"


def test_a_pose_outlives_the_console(file: Path) -> None:
    assert Poses(file).of("arm") == {}
    Poses(file).store("arm", " home ", JOINTS)
    Poses(file).store("other", "home", {"pan": 0.0})
    assert Poses(file).of("arm") == {"home": JOINTS}
    Poses(file).remove("arm", "home")
    assert Poses(file).of("arm") == {} and Poses(file).of("other") == {"home": {"pan": 0.0}}


@pytest.mark.parametrize("name", ["", "  ", "x" * (MAX_NAME + 1), "a\nb", "\x1b[31m"])
def test_a_name_that_is_none_is_refused(file: Path, name: str) -> None:
    with pytest.raises(BadPoses, match="1 to 40"):
        Poses(file).store("arm", name, JOINTS)
    assert not file.exists()


def test_there_is_a_limit(file: Path) -> None:
    poses = Poses(file)
    for number in range(MOST_POSES):
        poses.store("arm", str(number), JOINTS)
    poses.store("arm", "3", {"pan": 9.0})
    with pytest.raises(BadPoses, match="Remove one"):
        poses.store("arm", "one more", JOINTS)


@pytest.mark.parametrize("content", [b"", b"[]", b"\xff", b'{"arm": {"home": {"pan": "x"}}}', b"{" * 9000])
def test_a_file_that_cannot_be_read_is_kept_and_named(file: Path, content: bytes) -> None:
    file.parent.mkdir()
    file.write_bytes(content)
    for attempt in (lambda: Poses(file).of("arm"), lambda: Poses(file).store("arm", "home", JOINTS)):
        with pytest.raises(BadPoses, match=r"poses.json cannot be read.*move it away"):
            attempt()
    assert file.read_bytes() == content


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    with pytest.raises(BadPoses, match=r"cannot be (read|written)"):
        Poses(blocked / "poses.json").store("arm", "home", JOINTS)

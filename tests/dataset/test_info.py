"""An ``info.json`` of another program is read, or refused with a clear message and never with a traceback."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from strands_actors.surfaces.cli import dataset as commands
from strands_actors.surfaces.dataset.errors import DatasetError
from strands_actors.surfaces.dataset.info import decode_info
from strands_actors.surfaces.dataset.show import show

VIDEO = {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channels"], "info": None}
INFO: dict[str, Any] = {
    "codebase_version": "v3.0",
    "fps": 30,
    "total_episodes": 0,
    "features": {"action": {"dtype": "float32", "shape": [6], "names": None}, "observation.images.eye": VIDEO},
}


def changed(**fields: Any) -> bytes:
    return json.dumps({**INFO, **fields}).encode()


def feature(**fields: Any) -> bytes:
    return changed(features={"observation.images.eye": {**VIDEO, **fields}})


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "is damaged"),
        (b"{", "is damaged"),
        (b"[" * 100_000, "is damaged"),
        (b"\xff\xfe", "is damaged"),
        (b"[]", "version None"),
        (changed(codebase_version="v1.6"), "version 'v1.6'"),
        (changed(features=None), "features"),
        (changed(fps=0), "fps"),
        (changed(fps="30"), "fps"),
        (changed(features=None), "features"),
        (changed(features={"x": 3}), "features"),
        (changed(total_episodes=-1), "total_episodes"),
        (changed(total_frames="many"), "total_frames"),
        (feature(shape=None), "shape"),
        (feature(shape=[480, 640]), "height, width, channels"),
        (changed(features={"observation.images.x/../../../y": VIDEO}), "cannot be the name of a folder"),
        (changed(features={"..": VIDEO}), "cannot be the name of a folder"),
        (changed(features={"": VIDEO}), "cannot be the name of a folder"),
        (changed(features={"x" * 300: VIDEO}), "cannot be the name of a folder"),
    ],
    ids=lambda given: str(given)[:40],
)
def test_an_invalid_info_file_is_refused_by_name(data: bytes, text: str) -> None:
    with pytest.raises(DatasetError, match=text) as refused:
        decode_info(data, "info.json")
    assert str(refused.value).startswith("info.json")


def test_fields_that_another_program_omits_are_not_required() -> None:
    fields = {key: value for key, value in INFO.items() if key != "total_episodes"}
    found = decode_info(json.dumps(fields).encode(), "info.json")
    assert (found.total_episodes, found.total_frames, found.total_tasks) == (None, None, None)


@pytest.mark.parametrize(
    ("fields", "size"),
    [
        ({}, "640x480 "),
        ({"info": {"video.codec": "av1"}}, "640x480 av1"),
        ({"shape": [3, 480, 640], "names": ["channels", "height", "width"]}, "640x480 "),
        ({"names": None}, "640x480 "),
    ],
)
def test_a_dataset_without_an_episode_is_shown(
    fields: dict[str, Any], size: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "meta").mkdir()
    features = {**INFO["features"], "observation.images.eye": {**VIDEO, **fields}}
    (tmp_path / "meta/info.json").write_bytes(changed(fps=29.97, features=features))
    shown = show(tmp_path)
    assert (shown.fps, shown.cameras, shown.episodes) == (29.97, {"eye": size}, [])
    assert commands.show(tmp_path, False) == 0
    assert "29.97 fps" in capsys.readouterr().out

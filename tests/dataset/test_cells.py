"""Cells in tables of other programs. A row without a number is damaged. A column of another type is converted."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from strands_actors.surfaces.dataset.compact import compact, convert
from strands_actors.surfaces.dataset.errors import DamagedError, DatasetError
from strands_actors.surfaces.dataset.show import show

from .foreign import KEY, LENGTHS, write_older


def rewrite(
    path: Path, name: str, values: Callable[[list[Any]], list[Any]], kind: pa.DataType | None = None
) -> None:
    """Write a table anew with other values, or with another type, in one column."""
    table = pq.read_table(path)
    at = table.schema.get_field_index(name)
    column = pa.array(values(table[name].to_pylist()), kind or table.schema.field(name).type)
    pq.write_table(table.set_column(at, name, column), path)


def with_third(value: object) -> Callable[[list[Any]], list[Any]]:
    return lambda values: [*values[:2], value, *values[3:]]


FLOATS = pa.list_(pa.float32())
SECOND = "data/chunk-000/episode_000001.parquet"


@pytest.mark.parametrize(
    ("name", "values", "kind", "why", "frames"),
    [
        ("action", with_third([1.0, 2.0]), FLOATS, "frame 2 has not all numbers of action", 13),
        ("action", with_third(None), FLOATS, "frame 2 has not all numbers of action", 13),
        ("observation.state", with_third([1.0, None, 2.0]), FLOATS, "not all numbers of observation.state", 13),
        ("action", lambda rows: [row[:2] for row in rows], FLOATS, "action has 2 numbers, not 3", 14),
        (
            "action",
            lambda rows: [[str(x) for x in row] for row in rows],
            pa.list_(pa.string()),
            "states float32",
            14,
        ),
        ("timestamp", lambda rows: [str(x) for x in rows], pa.string(), "timestamp is string", 14),
    ],
)
def test_a_frame_without_all_its_numbers_damages_its_episode(
    name: str,
    values: Callable[[list[Any]], list[Any]],
    kind: pa.DataType,
    why: str,
    frames: int,
    tmp_path: Path,
) -> None:
    write_older(tmp_path / "older")
    rewrite(tmp_path / "older" / SECOND, name, values, kind)
    shown = show(tmp_path / "older")
    assert (shown.good, shown.damaged) == ([0, 2], [1])
    assert why in shown.episodes[1].damaged and shown.episodes[1].frames == frames
    with pytest.raises(DamagedError, match="episode 1 is damaged"):
        convert(tmp_path / "older", tmp_path / "new")


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("action", pa.list_(pa.float64())),
        ("action", pa.large_list(pa.float32())),
        ("action", pa.list_(pa.float32(), 3)),
        ("timestamp", pa.float64()),
        ("frame_index", pa.int32()),
    ],
)
def test_episodes_with_columns_of_other_types_and_order_are_converted(
    name: str, kind: pa.DataType, tmp_path: Path
) -> None:
    root = tmp_path / "older"
    write_older(root)
    rewrite(root / SECOND, name, lambda rows: rows, kind)
    table = pq.read_table(root / SECOND)
    pq.write_table(table.select(table.column_names[::-1]), root / SECOND)
    assert convert(root, tmp_path / "new").frames == sum(LENGTHS)
    copied = pq.read_table(tmp_path / "new/data/chunk-000/file-000.parquet").to_pylist()
    source = [row for path in sorted(root.glob("data/*/*.parquet")) for row in pq.read_table(path).to_pylist()]
    assert [row[name] for row in copied] == [row[name] for row in source]
    assert show(tmp_path / "new").good == [0, 1, 2]


def test_a_column_that_one_file_alone_has_is_named(tmp_path: Path) -> None:
    write_older(tmp_path / "older")
    table = pq.read_table(tmp_path / "older" / SECOND)
    pq.write_table(table.append_column("reward", pa.array([0.0] * table.num_rows)), tmp_path / "older" / SECOND)
    with pytest.raises(DatasetError, match=r"episode_000001.parquet has the column 'reward', unlike .*000000"):
        convert(tmp_path / "older", tmp_path / "new")


@pytest.mark.parametrize("version", ["v2.0", "v2.1"])
def test_a_nan_is_a_value_and_is_copied(version: str, tmp_path: Path) -> None:
    """LeRobot writes with Python's ``json``, which accepts NaN, too."""
    root = tmp_path / "older"
    write_older(root, version)
    rewrite(root / SECOND, "observation.state", with_third([math.nan, 1.0, math.inf]))
    if version == "v2.1":
        statistics = {name: [math.nan] * 3 for name in ("min", "max", "mean", "std")} | {"count": [14]}
        path = root / "meta/episodes_stats.jsonl"
        lines = path.read_text().splitlines()
        lines[1] = json.dumps({"episode_index": 1, "stats": {"action": statistics}})
        path.write_text("\n".join(lines))
    assert show(root).faults == []
    convert(root, tmp_path / "new")
    compact(tmp_path / "new", tmp_path / "again")
    assert show(tmp_path / "again").faults == [] and show(tmp_path / "again").good == [0, 1, 2]
    state = pq.read_table(tmp_path / "again/data/chunk-000/file-000.parquet")["observation.state"].to_pylist()
    assert math.isnan(state[LENGTHS[0] + 2][0]) and state[LENGTHS[0] + 2][1:] == [1.0, math.inf]


POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 99\n"


@pytest.mark.parametrize("name", [SECOND, f"videos/chunk-000/{KEY}/episode_000001.mp4"])
def test_a_pointer_of_git_lfs_is_reported(name: str, tmp_path: Path) -> None:
    write_older(tmp_path / "older")
    (tmp_path / "older" / name).write_text(POINTER)
    assert (
        show(tmp_path / "older")
        .episodes[1]
        .damaged.endswith("git-lfs pointer, not the file itself. Run: git lfs pull")
    )
    with pytest.raises(DamagedError, match="git lfs pull"):
        convert(tmp_path / "older", tmp_path / "new")


@pytest.mark.parametrize("name", ["meta/tasks.parquet", "meta/episodes/chunk-000/file-000.parquet"])
def test_a_git_lfs_pointer_in_place_of_an_index_is_reported(name: str, tmp_path: Path) -> None:
    write_older(tmp_path / "older")
    convert(tmp_path / "older", tmp_path / "new")
    (tmp_path / "new" / name).write_text(POINTER)
    assert any("git lfs pull" in fault for fault in show(tmp_path / "new").faults)


@pytest.mark.parametrize("name", ["meta/info.json", "meta/episodes.jsonl"])
def test_a_git_lfs_pointer_in_place_of_a_text_file_is_reported(name: str, tmp_path: Path) -> None:
    write_older(tmp_path / "older")
    (tmp_path / "older" / name).write_text(POINTER)
    with pytest.raises(DatasetError, match="git lfs pull"):
        convert(tmp_path / "older", tmp_path / "new")


def test_extra_files_of_macos_do_not_count_as_damage(tmp_path: Path) -> None:
    write_older(tmp_path / "older")
    convert(tmp_path / "older", tmp_path / "new")
    names = ["data/chunk-000/._file-000.parquet", "meta/episodes/chunk-000/._file-000.parquet"]
    for name in names:
        (tmp_path / "new" / name).write_bytes(b"\0\5\x16\7")
    shown = show(tmp_path / "new")
    assert (shown.good, shown.faults, shown.strange) == ([0, 1, 2], [], names)
    assert compact(tmp_path / "new", tmp_path / "again").frames == sum(LENGTHS)


def test_a_link_that_leads_to_itself_is_a_missing_video(tmp_path: Path) -> None:
    write_older(tmp_path / "older")
    path = tmp_path / f"older/videos/chunk-000/{KEY}/episode_000001.mp4"
    path.unlink()
    path.symlink_to(path.name)
    shown = show(tmp_path / "older")
    assert (shown.good, shown.damaged) == ([0, 2], [1])

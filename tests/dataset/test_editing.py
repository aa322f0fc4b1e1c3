"""Label, split and merge datasets. Every copy is a sound dataset with the frames and pictures of its sources."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import msgspec
import pyarrow.parquet as pq
import pytest

from strands_actors.surfaces import cli
from strands_actors.surfaces.dataset.editing import label, merge, split
from strands_actors.surfaces.dataset.errors import DamagedError, DatasetError
from strands_actors.surfaces.dataset.index import Index
from strands_actors.surfaces.dataset.layout import CameraShape
from strands_actors.surfaces.dataset.rows import frames_of
from strands_actors.surfaces.dataset.show import show

from .foreign import LENGTHS, write_older
from .quick import QUICK, grown


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two tasks: episodes 0 to 2, and 3 and 4."""
    root = grown(tmp_path_factory.mktemp("made") / "pick", 3)
    return grown(root, 2, frames=9, task="wave")


@pytest.fixture
def pick(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "pick"))


def actions(root: Path) -> list[list[list[float]]]:
    """Return the actions of each episode."""
    index = Index(root)
    return [frames_of(root, index.rows[number])["action"].to_pylist() for number in sorted(index.rows)]


def tasks(root: Path) -> list[str]:
    """Return the task of each episode, as its frames have it."""
    index = Index(root)
    found = []
    for number in sorted(index.rows):
        (task,) = set(frames_of(root, index.rows[number])["task_index"].to_pylist())
        found.append(index.tasks[task])
        assert index.rows[number].tasks == (index.tasks[task],)
    return found


def is_sound(root: Path) -> bool:
    shown = show(root)
    index = Index(root)
    for number, row in index.rows.items():
        table = frames_of(root, row)
        for name in ("index", "episode_index", "task_index"):
            values = table[name].to_pylist()
            assert (row.statistics[name]["min"], row.statistics[name]["max"]) == ([min(values)], [max(values)]), (
                number
            )
    return not (shown.damaged or shown.faults or shown.stray_files)


def test_a_label_changes_tasks_and_marks_and_nothing_else(pick: Path, tmp_path: Path) -> None:
    before = actions(pick)
    label(pick, tmp_path / "new", "1,3-4", task="open the drawer", mark="failed")
    copy = tmp_path / "new"
    assert is_sound(copy) and actions(copy) == before == actions(pick)
    place = "put the cube down"
    assert tasks(copy) == [place, "open the drawer", place, "open the drawer", "open the drawer"]
    assert Index(copy).tasks == [place, "open the drawer"], "a task that no episode has any more is left out"
    assert show(copy).good == [0, 2] and show(copy).episodes[1].defects == "failed"
    label(copy, tmp_path / "again", "all", mark="")
    assert show(tmp_path / "again").good == [0, 1, 2, 3, 4] and tasks(tmp_path / "again") == tasks(copy)


def test_parts_have_their_episodes_numbered_anew(pick: Path, tmp_path: Path) -> None:
    train, rest = tmp_path / "train", tmp_path / "rest"
    split(pick, {train: "0-1,4", rest: "3"})
    assert is_sound(train) and is_sound(rest)
    before = actions(pick)
    assert actions(train) == [before[0], before[1], before[4]] and actions(rest) == [before[3]]
    assert tasks(train) == ["put the cube down"] * 2 + ["wave"] and tasks(rest) == ["wave"]
    assert Index(rest).tasks == ["wave"], "its task has the number 0 now"


def test_shares_take_all_episodes_once(pick: Path, tmp_path: Path) -> None:
    folders = [tmp_path / "train", tmp_path / "val"]
    split(pick, dict(zip(folders, ("60%", "40%"), strict=True)))
    before = actions(pick)
    assert actions(folders[0]) == before[:3] and actions(folders[1]) == before[3:]
    mixed = [tmp_path / "mixed", tmp_path / "others"]
    done = split(pick, dict(zip(mixed, ("60%", "40%"), strict=True)), seed=5)
    assert [each.episodes for each in done] == [3, 2]
    assert sorted(actions(mixed[0]) + actions(mixed[1])) == sorted(before) and actions(mixed[0]) != before[:3]


def test_a_merge_has_every_episode_of_all_datasets(pick: Path, tmp_path: Path) -> None:
    other = grown(tmp_path / "other", 2, frames=7, task="wave")
    merge([other, pick], tmp_path / "all")
    root = tmp_path / "all"
    assert is_sound(root) and actions(root) == actions(other) + actions(pick)
    assert tasks(root) == ["wave"] * 2 + ["put the cube down"] * 3 + ["wave"] * 2
    assert Index(root).tasks == ["wave", "put the cube down"]
    assert pq.ParquetFile(root / "data/chunk-000/file-000.parquet").num_row_groups == 7


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"fps": 20}, "it has 20 fps, not 30"),
        ({"robot_type": "strands_koch"}, "it is of the robot strands_koch, not strands_so101"),
        ({"joints": ("a.pos", "b.pos", "c.pos")}, "action is float32 .* a.pos, b.pos, c.pos, not"),
        ({"cameras": (CameraShape("front", 32, 16),)}, "front is video 16x32x3, not video 16x16x3"),
        ({"cameras": (CameraShape("wrist", 16, 16),)}, "age_ms is float32 .* state, wrist, not .* state, front"),
        ({"units": ("rad", "rad", "percent")}, "is in rad, rad, percent, not in deg, deg, percent"),
        ({"units": ()}, "states units in only one of them"),
        ({"codec": "av1", "cameras": (CameraShape("front", 64, 64),)}, "front is video 64x64"),
    ],
)
def test_datasets_that_do_not_fit_are_not_merged(
    pick: Path, tmp_path: Path, changed: dict[str, Any], says: str
) -> None:
    layout = msgspec.structs.replace(QUICK, **changed)
    if changed.get("cameras") == (CameraShape("wrist", 16, 16),):
        layout = msgspec.structs.replace(layout, cameras=(CameraShape("wrist", 16, 16),))
    other = grown(tmp_path / "other", 1, layout=layout)
    with pytest.raises(DatasetError, match=says):
        merge([pick, other], tmp_path / "all")
    assert not (tmp_path / "all").exists()


def test_a_damaged_episode_is_refused_unless_it_is_left_out(pick: Path, tmp_path: Path) -> None:
    data = pick / "data/chunk-000/file-001.parquet"
    data.write_bytes(data.read_bytes()[:-20])
    for edit in (
        lambda: label(pick, tmp_path / "new", "0", mark="failed"),
        lambda: merge([pick, grown(tmp_path / "other")], tmp_path / "new"),
        lambda: split(pick, {tmp_path / "new": "0-1"}),
    ):
        with pytest.raises(DamagedError, match=r"pick: episode 1 is damaged: .*file-001"):
            edit()
        assert not (tmp_path / "new").exists()
    split(pick, {tmp_path / "new": "good"})
    assert is_sound(tmp_path / "new") and len(actions(tmp_path / "new")) == 4


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("label", "pick", "-o", "new", "--episodes", "0"), "nothing would change. Give a task or a mark"),
        (("label", "pick", "-o", "new", "--episodes", "0", "--task", " "), "the task is empty"),
        (("label", "pick", "-o", "new", "--episodes", "0-5", "--mark", "x"), "has no episodes 0-5. It has 5"),
        (("label", "pick", "-o", "pick", "--episodes", "0", "--mark", "x"), "pick exists already"),
        (("split", "pick", "a"), "'a' cannot be read. Write FOLDER=EPISODES"),
        (("split", "pick", "a=0", "a=1"), "each folder once"),
        (("split", "pick", "a=3-1"), "has no episodes 3-1"),
        (("split", "pick", "a=x"), "episodes 'x' cannot be read"),
        (("split", "pick", "a=80%", "b=30%"), "the shares are 110 % together"),
        (("split", "pick", "a=80%", "b=3"), "'3' is no share"),
        (("split", "pick", "a=1%"), "a would have no episode"),
        (("split", "pick", "a=0", "--seed", "3"), "a seed is only for shares"),
        (("merge", "pick", "-o", "new"), "give two datasets or more"),
        (("merge", "pick", "./pick", "-o", "new"), "each of them once"),
        (("merge", "pick", "nothing", "-o", "new"), "nothing is not a dataset"),
        (("merge", "pick", "older", "-o", "new"), "has the older version v2.1"),
    ],
)
def test_a_wrong_request_is_refused_in_one_line_and_leaves_nothing(
    pick: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    says: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_older(tmp_path / "older")
    before = sorted(path.name for path in tmp_path.iterdir())
    assert cli.run(("dataset", *arguments)) == cli.USAGE
    output = capsys.readouterr().err
    assert says in output and output.count("\n") == 1, output
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_the_commands_report_what_they_made(
    pick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Any:
        assert cli.run(("dataset", *arguments, "--json")) == 0
        return json.loads(capsys.readouterr().out)

    assert [part["episodes"] for part in run("split", "pick", "a=60%", "b=40%")] == [3, 2]
    assert run("merge", "a", "b", "-o", "both")["frames"] == 36
    assert run("label", "both", "-o", "labelled", "--episodes", "good", "--task", "tidy up")["episodes"] == 5
    assert run("show", "labelled")["episodes"][4]["task"] == "tidy up"


def test_a_converted_dataset_of_lerobot_is_split(tmp_path: Path) -> None:
    write_older(tmp_path / "older")
    assert cli.run(("dataset", "convert", str(tmp_path / "older"), "-o", str(tmp_path / "new"))) == 0
    split(tmp_path / "new", {tmp_path / "part": "1-2"})
    assert is_sound(tmp_path / "part") and len(actions(tmp_path / "part")[0]) == LENGTHS[1]

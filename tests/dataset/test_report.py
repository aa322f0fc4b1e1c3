"""The report names episodes that may harm a training, and is one page without foreign code."""

from __future__ import annotations

import base64
import io
import json
import math
import re
from collections.abc import Callable
from pathlib import Path

import av
import msgspec
import numpy as np
import pytest
from markupsafe import escape

from strands_actors.surfaces import cli
from strands_actors.surfaces.dataset.compact import compact, convert
from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.editing import label
from strands_actors.surfaces.dataset.layout import CameraShape, Layout
from strands_actors.surfaces.dataset.report.figures import Pictures, longest_run, motion_of
from strands_actors.surfaces.dataset.report.findings import Finding, Kind, find_outliers, outliers
from strands_actors.surfaces.dataset.report.measure import Report, measure
from strands_actors.surfaces.dataset.report.page import MEANINGS, TITLES, line, page
from strands_actors.surfaces.dataset.staging import Picture, Row, StagedEpisode, new_folder

from .foreign import write_older

FRONT = CameraShape("front", 32, 48)
LAYOUT = Layout("strands_so101", 30, ("pan.pos", "lift.pos"), (FRONT,), "mpeg4", ("deg", "percent"))
HOSTILE = "<script>alert('x')</script> & \"wave\""
FRAMES = 40


def picture(number: int, level: int = 120, corner: int = 0) -> Picture:
    shown = np.full((32, 48, 3), level, np.uint8)
    shown[:, number % 40 : number % 40 + 8] = 250
    shown[:8, :8] = corner
    return shown


class Recorded:
    """One episode, and its defects."""

    frames = FRAMES
    task = "wave"
    gap = 0
    phase = 0.0
    jump_at = -1
    freeze_at = FRAMES
    stuck_at = FRAMES
    level = 120
    offset = 0.0

    def __init__(self, **changes: object) -> None:
        vars(self).update(changes)

    def write(self, dataset: Dataset) -> None:
        episode = StagedEpisode(dataset.storage, new_folder(dataset.staging), LAYOUT, self.task)
        for number in range(self.frames):
            pan = 30 * math.sin(number / 6 + self.phase) + self.offset
            action = (pan + 90 * (number == self.jump_at), 50.0)
            at = min(number, self.stuck_at)
            state = (30 * math.sin(at / 6 + self.phase) + self.offset, 50.0)
            row = Row(state, action, action, (4.0, 9.0), self.gap if number == 2 else 0, ())
            shown = picture(min(number, self.freeze_at), self.level, corner=round(1000 * self.phase))
            episode.add(row, {"front": shown})
        episode.finish()
        dataset.commit(episode.folder)


USUAL = [Recorded(phase=0.01 * number) for number in range(6)]
WRONG = [
    Recorded(phase=0.07, frames=8),
    Recorded(phase=0.08, jump_at=20),
    Recorded(phase=0.09, freeze_at=15),
    Recorded(phase=0.10, stuck_at=15),
    Recorded(phase=0.11, level=30),
    Recorded(phase=0.12, offset=80.0, task=HOSTILE),
    Recorded(phase=0.13, gap=2),
    Recorded(phase=0.0),
]
EXPECTED = {
    6: {Kind.LENGTH},
    7: {Kind.HIGH, Kind.SPEED, Kind.JERK},
    8: {Kind.STILL},
    9: {Kind.REPEATED},
    10: {Kind.BRIGHTNESS},
    11: {Kind.LOW, Kind.HIGH, Kind.BEGIN},
    12: {Kind.GAPS},
    13: {Kind.SAME_MOTION, Kind.SAME_PICTURES},
}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("made") / "pick"
    dataset = Dataset(root)
    for episode in (*USUAL, *WRONG):
        episode.write(dataset)
    dataset.close()
    return root


def kinds(report: Report, episode: int) -> set[Kind]:
    return {finding.kind for finding in report.findings_of(episode)}


def test_each_defect_is_found_in_its_episode_and_none_in_usual_ones(root: Path) -> None:
    report = measure(root)
    for number, expected in EXPECTED.items():
        assert expected <= kinds(report, number), number
    assert {number: kinds(report, number) for number in range(6)} == {number: set() for number in range(6)}
    assert report.good == [0, 1, 2, 3, 4, 5]
    assert [finding.name for finding in report.findings_of(-1)] == ["lift"]
    same = next(finding for finding in report.findings_of(13) if finding.kind is Kind.SAME_MOTION)
    assert line(same) == "as episode 0"
    assert report.joints[0].unit == "deg" and report.joints[0].high == pytest.approx(110, abs=1)
    assert report.tasks == {"wave": 13, HOSTILE: 1} and report.frames == FRAMES * 13 + 8


def test_the_page_is_one_file_with_pictures_and_escapes_what_stands_in_a_dataset(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "report.html"
    assert cli.run(("dataset", "report", str(root), "-o", str(out))) == 0
    assert "14 episodes, 6 without a finding" in capsys.readouterr().out
    text = out.read_text()
    assert "<script" not in text and escape(HOSTILE) in text
    assert not re.findall(r"(?:src|href)=\"(?!data:image/jpeg;base64,|#episode-)", text)
    pictures = re.findall(r"base64,([^\"]+)\"", text)
    assert len(pictures) == 14 * 3
    with av.open(io.BytesIO(base64.b64decode(pictures[0]))) as jpeg:
        frame = next(jpeg.decode(video=0))
        assert (frame.width, frame.height) == (160, 106)
    assert cli.run(("dataset", "report", str(root), "-o", str(out), "--json")) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["good"] == [0, 1, 2, 3, 4, 5] and said["page"] == str(out)


@pytest.mark.parametrize("make", [compact, lambda root, into: label(root, into, "2", mark="failed")])
def test_a_copy_has_the_same_report(root: Path, tmp_path: Path, make: Callable[[Path, Path], object]) -> None:
    make(root, tmp_path / "copy")
    before, after = measure(root), measure(tmp_path / "copy")
    marked = [finding for finding in after.findings if finding.kind is Kind.MARK]
    assert [(finding.episode, finding.text) for finding in marked] in ([], [(2, "failed")])
    assert [finding for finding in after.findings if finding.kind is not Kind.MARK] == before.findings
    assert [each.pictures for each in after.episodes] == [each.pictures for each in before.episodes]


def test_a_dataset_of_lerobot_has_a_report(tmp_path: Path) -> None:
    write_older(tmp_path / "older")
    convert(tmp_path / "older", tmp_path / "new")
    report = measure(tmp_path / "new")
    assert report.good == [0, 1, 2] and report.joints[0].unit == ""
    assert "not stated" in page(report)


def test_a_damaged_episode_is_named_and_the_others_are_measured(root: Path, tmp_path: Path) -> None:
    compact(root, tmp_path / "copy")
    video = tmp_path / "copy/videos/observation.images.front/chunk-000/file-000.mp4"
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])
    report = measure(tmp_path / "copy")
    assert kinds(report, 13) == {Kind.DAMAGED} and 13 not in report.good
    assert "Damaged" in page(report)


def test_a_dataset_without_episodes_has_an_empty_report(tmp_path: Path) -> None:
    (tmp_path / "set/meta").mkdir(parents=True)
    info = LAYOUT.info(0, 0, 0)
    (tmp_path / "set/meta/info.json").write_text(json.dumps(info))
    assert "Nothing unusual was found" in page(measure(tmp_path / "set"))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("report", "nothing"), "nothing is not a dataset"),
        (("report", "older"), "has the older version v2.1"),
        (("report", "older", "-o", "page.txt"), "page.txt does not end with .html"),
    ],
)
def test_a_wrong_request_is_refused_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    says: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_older(tmp_path / "older")
    assert cli.run(("dataset", *arguments)) == cli.USAGE
    output = capsys.readouterr().err
    assert says in output and output.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["older"]


def test_equal_episodes_have_no_outliers_and_few_are_not_compared() -> None:
    assert outliers(dict.fromkeys(range(9), 3.0), least=0.0) == {}
    assert outliers({0: 1.0, 1: 1.0, 2: 99.0}, least=0.1) == {}
    assert outliers({**dict.fromkeys(range(8), 3.0), 8: math.nan, 9: 4.0}, least=0.1) == {8: 3.0, 9: 3.0}
    (found,) = find_outliers(Kind.LENGTH, {**dict.fromkeys(range(8), 3.0), 8: 9.0})
    assert found == Finding(Kind.LENGTH, 8, "", 9.0, 3.0) and line(found) == "9 s, usually 3 s"


def test_figures_of_a_known_motion() -> None:
    seconds = np.arange(30) / 10
    action = np.stack([seconds**3, np.zeros(30)], 1)
    motion = motion_of(action, action, 10.0, np.ptp(action, axis=0))
    assert motion.jerk.tolist() == pytest.approx([6.0, 0.0]), "the third derivative of t³"
    assert motion.high.tolist() == pytest.approx([2.9**3, 0.0]) and motion.repeated == 0
    one = motion_of(action[:1], action[:1], 10.0, np.zeros(2))
    assert one.speed.tolist() == one.jerk.tolist() == [0.0, 0.0]
    assert longest_run(np.array([], bool)) == 0 and longest_run(np.array([1, 0, 1, 1, 0], bool)) == 2


def test_pictures_count_only_while_the_robot_moves() -> None:
    figures = Pictures()
    for number in (0, 1, 1, 1, 1, 2):
        figures.add(picture(number), is_moving=True)
    assert figures.still == 3
    resting = Pictures()
    for _ in range(5):
        resting.add(picture(0), is_moving=False)
    assert resting.still == 0 and resting.brightness == pytest.approx(picture(0)[::4, ::4].mean())


def test_each_kind_has_a_title_a_meaning_and_a_line() -> None:
    assert set(TITLES) == set(MEANINGS) == set(Kind)
    for kind in Kind:
        assert line(Finding(kind, 0, "pan", 1.0, 2.0, "text"))
    assert msgspec.json.encode(Finding(Kind.LOW, 1))

"""A page records episodes of a robot on its twin, and replays them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import httpx
import pytest

from strands_actors.surfaces.web.episodes import Track, _thinned, listed
from strands_actors.surfaces.web.recorders import NAME
from tests.cli.command import Command, RobotProcess

from .browser import Visitor
from .serving import console_of


def look(visitor: Visitor, path: str) -> Any:
    answer = visitor.http.get(path)
    assert answer.status_code == 200, (answer.status_code, answer.text)
    return answer.json()


def test_a_page_records_keeps_discards_and_replays_episodes(cli: Command, tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    arguments = ("--recordings", str(folder))
    with (
        RobotProcess(cli) as robot,
        console_of(cli, *arguments) as facts,
        Visitor(facts["url"]) as visitor,
    ):
        robot.call("release")
        assert look(visitor, "/robots/so101/recorder") == {"recorder": None}
        assert look(visitor, "/recordings")["recordings"] == []
        order = {"dataset": "pick-cube", "task": "pick the cube up", "fps": 20}
        opened = visitor.order("/robots/so101/recorder/open", **order)["recorder"]
        assert (opened["state"], opened["dataset"], opened["saved"]) == ("waiting", "pick-cube", 0)
        second = visitor.http.post("/robots/so101/recorder/open", json=order)
        assert second.status_code == 409 and "End it first" in second.text

        def press(word: str) -> dict[str, Any]:
            recorder: dict[str, Any] = visitor.order("/robots/so101/recorder/press", word=word)["recorder"]
            return recorder

        assert press("start")["state"] == "recording"
        time.sleep(0.5)
        assert "episode 0" in press("finish")["text"]
        assert press("start")["state"] == "recording"
        assert press("discard")["state"] == "waiting"
        assert "no episode is running" in press("finish")["text"]
        ended = press("quit")
        assert (ended["state"], ended["saved"]) == ("ended", 1)

        (entry,) = look(visitor, "/recordings")["recordings"]
        assert entry["is_dataset"] and entry["about"] == "so101, 1 episodes, 20 fps"
        (episode,) = look(visitor, "/recordings/pick-cube/episodes")["episodes"]
        assert episode["number"] == 0 and episode["frames"] > 5 and episode["task"] == "pick the cube up"
        track = look(visitor, "/recordings/pick-cube/episodes/0")
        assert len(track["times"]) == len(track["measured"]) == len(track["commanded"]) == episode["frames"]
        assert track["robot_type"] == "so101" and set(track["units"]) >= set(track["joints"])
        assert len(visitor.http.get("/scenes/so101").content) > 1000
        for path in ("/recordings/pick-cube/episodes/7", "/recordings/pick-cube/track"):
            assert visitor.http.get(path).status_code == 409, path
        for path in ("/recordings/..%2f..%2fetc/episodes", "/recordings/nothing/episodes", "/scenes/nobody"):
            assert visitor.http.get(path).status_code == 404, path


def test_a_recording_is_replayed(cli: Command, tmp_path: Path) -> None:
    with (
        RobotProcess(cli),
        console_of(cli, "--recordings", str(tmp_path)) as facts,
        Visitor(facts["url"]) as visitor,
    ):
        done = cli.run("record", "so101", "-o", str(tmp_path / "run.mcap"), "--seconds", "0.5")
        assert done.returncode == 0, done.stderr
        assert [each["name"] for each in look(visitor, "/recordings")["recordings"]] == ["run.mcap"]
        track = look(visitor, "/recordings/run.mcap/track")
        assert track["robot_type"] == "so101" and len(track["times"]) > 10
        assert track["times"][0] == 0 and track["times"] == sorted(track["times"])
        assert all(value is not None for value in track["measured"][-1])


def test_a_recorder_is_refused_without_a_name_a_task_or_a_robot(shared_visitor: Visitor) -> None:
    visitor = shared_visitor

    def open_with(**order: Any) -> httpx.Response:
        return visitor.http.post("/robots/nobody/recorder/open", json={"dataset": "a", "task": "b", **order})

    assert (answer := open_with(dataset="../a")).status_code == 400 and "letters" in answer.text
    assert (answer := open_with(task=" ")).status_code == 400 and "Give a sentence" in answer.text
    assert visitor.http.post("/robots/nobody/recorder/press", json={"word": "start"}).status_code == 409
    assert visitor.http.post("/robots/nobody/recorder/press", json={"word": "rm"}).status_code == 400
    recorder = open_with().json()["recorder"]
    assert recorder["state"] == "ended" and "nobody" in recorder["text"]


@pytest.mark.parametrize("name", ["..", ".hidden", "", "a/b", "a\n", "x" * 65])
def test_a_dataset_has_the_name_of_a_folder(name: str) -> None:
    assert not NAME.fullmatch(name)


def test_long_tracks_are_thinned_out_and_a_missing_folder_is_empty(tmp_path: Path) -> None:
    assert listed(tmp_path / "none") == []
    rows: list[list[float | None]] = [[float(at)] for at in range(50_000)]
    track = _thinned(Track("a", "", ("j",), {}, [float(at) for at in range(50_000)], rows, rows))
    assert len(track.times) == len(track.measured) == 16_667 and track.times[1] == 3.0

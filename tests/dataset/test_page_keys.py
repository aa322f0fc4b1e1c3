"""The keys of a recorder from elsewhere: from the page of a teleoperation, and from a page of its
own."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from websockets.sync.client import ClientConnection

from strands_actors import Robot, Teleoperator
from strands_actors.supervisors.instrument import Entry, Kind, encode
from strands_actors.supervisors.root.messages import EpisodeKey, Operate
from strands_actors.surfaces.dataset.index import Index
from strands_actors.surfaces.dataset.run import Onlooker
from strands_actors.surfaces.dataset.session import Event, Progress
from strands_actors.surfaces.recording.views import decode_entries, keys_pressed
from tests.answers import json_of, until
from tests.cli.command import Command
from tests.teleop.test_page import operator

from .made import check
from .test_so101 import PATIENCE_S, heard, stand_in

LATE_MS = 5_000.0


def say(socket: ClientConnection, episode: str = "", late_ms: float = 0.0) -> None:
    at_ms = time.monotonic() * 1e3 - late_ms
    socket.send(json.dumps({"held": False, "rates": {}, "at_ms": at_ms, "episode": episode}))


def next_told(socket: ClientConnection) -> dict[str, Any]:
    """As a browser: who says nothing loses the seat."""
    say(socket)
    return dict(json.loads(socket.recv(PATIENCE_S)))


def shown(socket: ClientConnection, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """What the page is told of the recorder, once it is so."""
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        told = next_told(socket).get("episode")
        if told is not None and condition(told):
            return dict(told)
    raise AssertionError(told)


@pytest.mark.long
def test_keys_on_the_page_of_a_teleoperation_reach_a_recorder_beside_it(tmp_path: Path) -> None:
    root = tmp_path / "set"
    with Robot("so101", mode="real", transport="twin") as arm, Teleoperator("page") as page:
        assert arm.connect_eagerly() is None
        json_of(arm.attach_teleop(page))
        address = until(lambda: page.address, "it is served")
        with stand_in(root) as recorder, operator(address) as socket:
            say(socket)
            assert not shown(socket, lambda told: bool(told["text"]))["running"]
            say(socket, "start")
            heard(recorder, "started")
            assert "episode 0" in shown(socket, lambda told: told["running"])["said"]
            say(socket, "start")
            assert "an episode runs" in heard(recorder, "refused")["text"]
            say(socket, "finish", LATE_MS)  # it was stuck in a network: that is no wish of now
            assert "finish: that was pressed" in heard(recorder, "refused")["text"]
            say(socket, "finish")
            assert heard(recorder, "saved")["frames"] > 0
            shown(socket, lambda told: not told["running"] and told["said"].endswith("saved"))
            recorder.kill()
            until(
                lambda: "episode" not in next_told(socket),
                "a recorder that is gone is shown no more",
            )
        json_of(arm.stop_task())
    assert len(Index(root).episodes) == 1


@pytest.mark.long
def test_a_recorder_has_a_page_of_its_own(tmp_path: Path) -> None:
    root = tmp_path / "set"
    command = Command(Path(os.environ["STRANDS_ACTORS_RUN"]))
    arguments = ("record", "so101", "--dataset", str(root), "--task", "wave", "--episodes", "1", "--keys", "page")
    with Robot("so101", mode="real", transport="twin") as arm:
        assert arm.connect_eagerly() is None
        with command.start(*arguments) as recorder:  # nobody is at its standard input
            try:
                assert recorder.stderr is not None
                address = next(line for line in recorder.stderr if "http" in line).split()[1]
                with operator(address) as socket:
                    shown(socket, lambda told: bool(told["text"]))
                    say(socket, "start")
                    shown(socket, lambda told: told["running"])
                    say(socket, "discard")
                    shown(socket, lambda told: told["said"] == "episode 0: discarded")
                    say(socket, "start")
                    shown(socket, lambda told: told["running"])
                    time.sleep(0.5)
                    say(socket, "finish")
                    assert recorder.wait(PATIENCE_S) == 0
            finally:
                recorder.kill()
    assert check(root) == 1


def test_only_what_the_root_notes_is_a_key() -> None:
    """What merely reached it may be of a policy, which has no operator."""
    key = EpisodeKey(7, "start")
    lines = [(Kind.TOOK, key), (Kind.NOTED, Operate(7, True)), (Kind.SENT, key), (Kind.NOTED, key)]
    entries = [
        msgspec.Raw(encode(Entry(kind, "tasks", 7, 0, "", msgspec.Raw(encode(body))))) for kind, body in lines
    ]
    assert list(keys_pressed(decode_entries(encode(entries)))) == [key]


def test_an_onlooker_sees_an_episode_run_from_its_start_to_its_end() -> None:
    onlooker = Onlooker()
    seen = []
    for event in (
        Event("started", 2),
        Event("refused", 2, text="no"),
        Event("saved", 2, 9),
        Event("refused", 3, text="no"),
    ):
        onlooker.hear(event)
        seen.append((onlooker.state.running, onlooker.state.said))
    assert seen == [
        (True, "episode 2: recording"),
        (True, "no"),
        (False, "episode 2: 9 frames, nothing missing; saved"),
        (False, "no"),
    ]
    onlooker.show(Progress("recording", 3, 1, 4, 2.0, 30.0, 1, 0, 5 * 10**9))
    assert onlooker.state.running and onlooker.state.text == "1/4 saved, recording 2 s, 30 fps, 1 gaps, 5.0 GB left"
    assert onlooker.state.said == "no"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("-o", "x.mcap", "--keys", "page"), "give --dataset DIR"),
        (("--dataset", "set", "--task", "x", "--keys", "pedal"), "use page, gamepad, phone"),
        (("--dataset", "set", "--task", "x", "--keys", "phone:host:99999"), "cannot listen on 'host:99999'"),
    ],
)
def test_a_page_that_there_is_not_is_refused(arguments: tuple[str, ...], told: str, tmp_path: Path) -> None:
    done = Command(tmp_path).run("record", "so101", *arguments, cwd=tmp_path)
    assert done.returncode and told in done.stderr
    assert not (tmp_path / "set").exists()

"""Control a recorder by the keys of a web page: the page of a teleoperation, or the recorder's own page."""

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
from strands_actors.surfaces.dataset.order import Event, Progress
from strands_actors.surfaces.dataset.run import Onlooker
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
    """Return the next message. Send one first, as a browser does, because a silent client loses the seat."""
    say(socket)
    return dict(json.loads(socket.recv(PATIENCE_S)))


def shown(socket: ClientConnection, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Wait until the recorder's status on the page meets the condition, and return it."""
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        status = next_told(socket).get("episode")
        if status is not None and condition(status):
            return dict(status)
    raise AssertionError(status)


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
            assert "episode 0" in shown(socket, lambda told: told["running"])["last_event"]
            say(socket, "start")
            assert "an episode is running" in heard(recorder, "refused")["text"]
            say(socket, "finish", LATE_MS)  # the network delayed it, so it no longer counts
            assert "finish: the key press arrived" in heard(recorder, "refused")["text"]
            say(socket, "finish")
            assert heard(recorder, "saved")["frames"] > 0
            shown(socket, lambda told: not told["running"] and told["last_event"].endswith("saved"))
            recorder.kill()
            until(
                lambda: "episode" not in next_told(socket),
                "a recorder that is gone is shown no more",
            )
        json_of(arm.stop_task())
    assert len(Index(root).episodes) == 1


@pytest.mark.long
def test_a_recorder_has_its_own_page(tmp_path: Path) -> None:
    root = tmp_path / "set"
    command = Command(Path(os.environ["STRANDS_ACTORS_RUN"]))
    arguments = ("record", "so101", "--dataset", str(root), "--task", "wave", "--episodes", "1", "--keys", "page")
    with Robot("so101", mode="real", transport="twin") as arm:
        assert arm.connect_eagerly() is None
        with command.start(*arguments) as recorder:  # without a terminal at its standard input
            try:
                assert recorder.stderr is not None
                address = next(line for line in recorder.stderr if "http" in line).split()[1]
                with operator(address) as socket:
                    shown(socket, lambda told: bool(told["text"]))
                    say(socket, "start")
                    shown(socket, lambda told: told["running"])
                    say(socket, "discard")
                    shown(socket, lambda told: told["last_event"] == "episode 0: discarded")
                    say(socket, "start")
                    shown(socket, lambda told: told["running"])
                    time.sleep(0.5)
                    say(socket, "finish")
                    assert recorder.wait(PATIENCE_S) == 0
            finally:
                recorder.kill()
    assert check(root) == 1


def test_only_keys_that_the_root_noted_count() -> None:
    """Other messages may come from a policy, which has no operator."""
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
        onlooker.add_event(event)
        seen.append((onlooker.state.running, onlooker.state.last_event))
    assert seen == [
        (True, "episode 2: recording"),
        (True, "no"),
        (False, "episode 2: 9 frames, nothing missing; saved"),
        (False, "no"),
    ]
    onlooker.show(Progress("recording", 3, 1, 4, 2.0, 30.0, 1, 0, 5 * 10**9))
    assert onlooker.state.running and onlooker.state.text == "1/4 saved, recording 2 s, 30 fps, 1 gaps, 5.0 GB left"
    assert onlooker.state.last_event == "no"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-o", "x.mcap", "--keys", "page"), "Give --dataset DIR"),
        (("--dataset", "set", "--task", "x", "--keys", "pedal"), "Use page, gamepad, phone"),
        (("--dataset", "set", "--task", "x", "--keys", "phone:host:99999"), "cannot listen on 'host:99999'"),
    ],
)
def test_an_unknown_page_is_refused(arguments: tuple[str, ...], message: str, tmp_path: Path) -> None:
    done = Command(tmp_path).run("record", "so101", *arguments, cwd=tmp_path)
    assert done.returncode and message in done.stderr
    assert not (tmp_path / "set").exists()

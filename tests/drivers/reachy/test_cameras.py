"""Test pictures of Reachy's camera over WebRTC, with a stand-in for the daemon's media server. Both ends use
aiortc, with GStreamer's signalling between them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import numpy
import pytest
import trio

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.webrtc import LATE_S, Stamps, WebRtcVideo
from strands_actors.surfaces.cameras import Frame, StaleFrame
from strands_actors.testing import Twin
from tests.answers import status
from tests.cameras.looking import until

from .media import HEIGHT, WIDTH

ROOT = Path(__file__).parents[3]
RED, BLUE = (200, 30, 30), (30, 30, 200)
NEAR = 20
"""Tolerance of a colour that went through an encoder."""


class Media:
    def __init__(self, name: str = "reachymini") -> None:
        command = [sys.executable, "-m", "tests.drivers.reachy.media", name]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT)
        assert self.process.stdout is not None
        self.port = int(self.process.stdout.readline())

    def order(self, line: str) -> None:
        assert self.process.stdin is not None
        print(line, file=self.process.stdin, flush=True)

    def close(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.process.pid, signal.SIGCONT)
        self.process.kill()
        self.process.communicate()


@pytest.fixture
def media() -> Iterator[Media]:
    started = Media()
    yield started
    started.close()


@pytest.fixture
def reachy(media: Media, tmp_path: Path) -> Iterator[RealRobot]:
    with Twin("reachy_mini", tmp_path) as twin:
        robot = Robot("reachy_mini", mode="real", port=twin.port, media_port=media.port, cameras={"head": {}})
        try:
            until(lambda: robot.connect_eagerly() is None, "it is connected")
            yield robot
        finally:
            robot.cleanup()


def is_of(colour: tuple[int, int, int], frame: Frame) -> bool:
    assert frame.image.shape == (HEIGHT, WIDTH, 3)
    return bool(numpy.abs(frame.image.mean((0, 1)) - colour).max() < NEAR)


def sees(robot: RealRobot, colour: tuple[int, int, int]) -> bool:
    try:
        return is_of(colour, robot.read_camera("head"))
    except StaleFrame:
        return False


def told(robot: RealRobot) -> tuple[str, str]:
    camera = status(robot)["cameras"]["head"]
    return camera["state"], camera["why"] or ""


def opened(robot: RealRobot) -> int:
    return int(status(robot)["cameras"]["head"]["opened"])


def test_the_robots_camera_is_a_camera_like_any_other(reachy: RealRobot, media: Media) -> None:
    until(lambda: sees(reachy, RED), "a picture")
    first = reachy.read_camera("head")
    media.order("colour 30 30 200")
    until(lambda: sees(reachy, BLUE), "the next one")
    newest = reachy.read_camera("head")
    assert newest.sequence > first.sequence and newest.captured_ns > first.captured_ns
    assert told(reachy) == ("streaming", "")
    assert isinstance(reachy.get_observation(images=True)["head"], Frame)


@pytest.mark.long
def test_a_stream_that_ends_is_opened_again(reachy: RealRobot, media: Media) -> None:
    until(lambda: sees(reachy, RED), "a picture")
    media.order("end")
    until(lambda: opened(reachy) > 1 and sees(reachy, RED), "it is opened again")
    media.order("leave")
    media.order("end")
    until(lambda: "no video sender 'reachymini' there. Senders: " in told(reachy)[1], "it is told who streams")
    with pytest.raises(StaleFrame):
        reachy.read_camera("head")
    media.close()
    until(lambda: "no reachymini" not in told(reachy)[1] and told(reachy)[0] == "unavailable", "nobody is there")


@contextlib.asynccontextmanager
async def stream(port: int) -> AsyncIterator[WebRtcVideo]:
    video = WebRtcVideo(f"ws://127.0.0.1:{port}", "reachymini")
    await video.open()
    try:
        yield video
    finally:
        await video.aclose()


def open_and_close(port: int) -> None:
    async def use() -> None:
        async with stream(port) as video:
            picture = await video.read()
            assert numpy.abs(picture.image.mean((0, 1)) - RED).max() < NEAR
        assert not video._thread.is_alive()

    trio.run(use)


def test_a_stream_is_left_in_order(media: Media) -> None:
    for _ in range(2):
        open_and_close(media.port)


@pytest.mark.parametrize(
    ("order", "why"),
    [
        ("end", "has ended the stream|connection has closed|no video"),  # whichever arrives first
        ("mute", "no picture of reachymini within 2 s"),
        ("freeze", "no picture of reachymini within 2 s"),
        ("kill", "was lost|no video|connection has|no picture"),
    ],
)
def test_the_reason_for_the_end_of_the_stream_is_reported(media: Media, order: str, why: str) -> None:
    async def use() -> None:
        async with stream(media.port) as video:
            match order:
                case "freeze":
                    os.kill(media.process.pid, signal.SIGSTOP)
                case "kill":
                    media.process.kill()
                case _:
                    media.order(order)
            with trio.fail_after(30), pytest.raises(WireDown, match=why):
                while True:
                    await video.read()
        video._thread.join(5.0)
        assert not video._thread.is_alive()

    trio.run(use)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "no message of a signalling server"),
        ("[" * 20_000, "no message of a signalling server"),
        ('{"type": "error", "details": "out of order"}', "reports an error: out of order"),
        ('{"type": "peer", "sessionId": "another", "sdp": {"type": "offer", "sdp": "v"}}', ""),
        ('{"type": "peerStatusChanged", "roles": ["producer"], "peerId": "x", "meta": null}', ""),
    ],
)
def test_nonsense_ends_the_stream_or_is_passed_over(media: Media, text: str, why: str) -> None:
    async def use() -> None:
        async with stream(media.port) as video:
            media.order(f"say {text}")
            with trio.fail_after(20):
                if why:
                    with pytest.raises(WireDown, match=why):
                        while True:
                            await video.read()
                for _ in range(0 if why else 20):
                    await video.read()

    trio.run(use)


def test_a_missing_server_is_reported() -> None:
    with pytest.raises(WireDown, match=r"ws://127\.0\.0\.1:9"):
        open_and_close(9)


# -- the time of a picture


def test_a_picture_that_waited_has_its_true_age() -> None:
    stamps = Stamps()
    taken = [stamps.captured_s(at, 1000.0 + at) for at in (5.0, 5.1, 5.2)]
    assert taken == pytest.approx([1005.0, 1005.1, 1005.2], abs=1e-3)
    assert stamps.captured_s(5.3, 1000.0 + 9.3) == pytest.approx(1005.3, abs=2e-3), (
        "a picture that is four seconds late has its true time"
    )
    assert stamps.captured_s(9.2, 1000.0 + 9.4) == pytest.approx(1009.2, abs=2e-3)


def test_a_faster_one_shows_that_those_before_were_late() -> None:
    stamps = Stamps()
    assert stamps.captured_s(0.0, 100.5) == 100.5
    assert stamps.captured_s(1.0, 101.2) == pytest.approx(101.2)
    assert stamps.captured_s(2.0, 102.5) == pytest.approx(102.2, abs=1e-3)


def test_a_slower_clock_is_tracked() -> None:
    """The clock is slower by 100 parts in a million, for an hour. The picture does not become late by that."""
    stamps = Stamps()
    late_s = [now_s - stamps.captured_s(now_s * (1 - 1e-4), 500.0 + now_s) + 500.0 for now_s in range(3600)]
    assert max(late_s) < 0.01


def test_stamps_that_go_back_restart_the_count() -> None:
    stamps = Stamps()
    stamps.captured_s(50.0, 150.0)
    assert stamps.captured_s(0.0, 150.5) == pytest.approx(150.5)
    assert stamps.captured_s(0.1, 150.0 + 0.6 + LATE_S) == pytest.approx(150.6, abs=2e-3)


def test_each_is_later_than_the_one_before() -> None:
    stamps = Stamps()
    first = stamps.captured_s(0.0, 100.5)
    assert stamps.captured_s(0.1, 100.1) > first

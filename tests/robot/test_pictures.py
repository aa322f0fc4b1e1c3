"""A picture of a simulation is an array that a notebook shows, and ``video()`` films into a file."""

from __future__ import annotations

import struct
import threading
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image, ImageSequence

from strands_actors import Robot
from strands_actors.caller.handle.robot import SimRobot
from strands_actors.simulation.film import Size, checked, write
from strands_actors.simulation.gif import write_gif
from strands_actors.simulation.handle import SimulationError
from strands_actors.simulation.picture import RenderedPicture
from tests.answers import json_of, until

WIDTH, HEIGHT = 96, 64


@pytest.fixture
def sim(run_dir: Path) -> Iterator[SimRobot]:
    with Robot("so101") as robot:
        yield robot


def pixels_of(png: bytes) -> bytes:
    """Return the rows of a PNG without filters, each behind a zero."""
    size = struct.unpack(">I", png[33:37])[0]
    assert png[37:41] == b"IDAT"
    return zlib.decompress(png[41 : 41 + size])


def test_a_notebook_shows_a_picture_and_its_parts_but_no_other_array() -> None:
    picture = RenderedPicture.of(bytes(range(24)), 4, 2)
    assert picture.tolist() == np.arange(24).reshape(2, 4, 3).tolist()
    assert picture.flags.writeable
    png = picture._repr_png_()
    assert png is not None
    assert pixels_of(png) == b"\0" + bytes(range(12)) + b"\0" + bytes(range(12, 24))
    part = picture[:1]._repr_png_()
    assert part is not None
    assert pixels_of(part) == b"\0" + bytes(range(12))
    for other in (picture[..., 0], picture.astype(float), picture[:, :, :2], picture[:0]):
        assert other._repr_png_() is None


def test_what_is_computed_of_a_picture_is_an_ordinary_array_or_number() -> None:
    picture = RenderedPicture.of(bytes(range(24)), 4, 2)
    assert type(picture + 1) is np.ndarray
    assert type(picture.mean()) is np.float64
    assert type(picture.max()) is np.uint8


def moving(count: int) -> list[np.ndarray[Any, np.dtype[np.uint8]]]:
    """Return pictures of a red square that moves over a blue shade."""
    pictures = []
    for index in range(count):
        picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        picture[..., 2] = np.linspace(80, 200, WIDTH).astype(np.uint8)
        picture[20:40, 5 + 8 * index : 25 + 8 * index] = (220, 30, 20)
        pictures.append(picture)
    return pictures


def test_a_gif_has_the_pictures_that_were_written(tmp_path: Path) -> None:
    pictures = moving(6)
    write_gif(tmp_path / "film.gif", pictures, 25)
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.n_frames, film.size, film.info["duration"], film.info["loop"]) == (6, (WIDTH, HEIGHT), 40, 0)  # type: ignore[attr-defined]
        for index, picture in enumerate(pictures):
            film.seek(index)
            shown = np.asarray(film.convert("RGB")).astype(int)
            assert np.abs(shown - picture).max() <= 8


def test_a_gif_with_more_codes_than_its_table_holds_can_be_read(tmp_path: Path) -> None:
    noise = np.random.default_rng(3).integers(0, 256, (200, 200, 3), dtype=np.uint8)
    write_gif(tmp_path / "noise.gif", [noise], 10)
    with Image.open(tmp_path / "noise.gif") as film:
        shown = np.asarray(film.convert("RGB")).astype(int)
    assert np.abs(shown - noise).mean() < 20


def frames_of(path: Path) -> tuple[list[np.ndarray[Any, Any]], float]:
    with av.open(str(path)) as container:
        rate = container.streams.video[0].average_rate
        assert rate is not None
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)], float(rate)


def test_an_mp4_has_the_pictures_that_were_written(tmp_path: Path) -> None:
    pictures = moving(8)
    write(tmp_path / "film.mp4", iter(pictures), 20, Size(WIDTH, HEIGHT))
    frames, rate = frames_of(tmp_path / "film.mp4")
    assert (len(frames), rate) == (8, 20.0)
    for shown, picture in zip(frames, pictures, strict=True):
        assert np.abs(shown.astype(int) - picture).mean() < 12
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def test_an_old_film_stays_if_the_new_one_cannot_be_drawn(tmp_path: Path) -> None:
    file = tmp_path / "film.gif"
    file.write_bytes(b"old")

    def broken() -> Iterator[Any]:
        yield moving(1)[0]
        raise SimulationError("no picture")

    with pytest.raises(SimulationError, match="no picture"):
        write(file, broken(), 10, Size(WIDTH, HEIGHT))
    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ((3, 25, 64, 64), TypeError, "path is 3. Give the name of a file that ends with .mp4 or .gif"),
        (("run.avi", 25, 64, 64), ValueError, "path is 'run.avi'. Give a name that ends with .mp4 or .gif"),
        (("run.gif", 0, 64, 64), ValueError, "fps is 0. Give pictures per second as a whole number, 1 to 50"),
        (("run.gif", 25, 0, 64), ValueError, "the picture's size is 0 x 64"),
        (("run.mp4", 25, 65, 64), ValueError, "Give an even width and height of 64 pixels or more for .mp4"),
        (("nowhere/run.gif", 25, 64, 64), SimulationError, "there is no folder .*nowhere"),
    ],
)
def test_a_film_that_cannot_be_made_is_refused(
    arguments: tuple[Any, ...], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        checked(*arguments)


def test_video_films_what_a_block_does(sim: SimRobot, tmp_path: Path) -> None:
    with sim.video(tmp_path / "run.mp4", width=128, height=96, camera="top") as film:
        assert film._repr_html_() is None
        until(lambda: len(film._poses) > 3, "the first pictures")
        json_of(sim.step(400, {"shoulder_pan": 60.0}))
        filmed = len(film._poses)
        until(lambda: len(film._poses) > filmed + 3, "pictures of the moved arm")
    frames, rate = frames_of(tmp_path / "run.mp4")
    assert rate == 25.0
    assert film.frames == len(frames) >= 8
    assert np.abs(frames[-1].astype(int) - frames[0]).mean() > 1, "the arm has moved"
    html = film._repr_html_()
    assert html is not None
    assert html.startswith('<video controls src="data:video/mp4;base64,')


def test_video_films_for_some_seconds_while_another_thread_moves_the_robot(sim: SimRobot, tmp_path: Path) -> None:
    ended = threading.Event()

    def swing() -> None:
        while not ended.wait(0.3):
            sim.send_action({"shoulder_pan": -60.0 if sim.get_observation()["shoulder_pan"] > 0 else 60.0})

    mover = threading.Thread(target=swing)
    mover.start()
    try:
        film = sim.video(str(tmp_path / "run.gif"), seconds=3.0, fps=10, width=80, height=60)
    finally:
        ended.set()
        mover.join()
    with Image.open(tmp_path / "run.gif") as shown:
        frames = [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(shown)]
    assert film.frames == len(frames) > 3
    assert max(np.abs(frame - frames[0]).mean() for frame in frames) > 0.5, "the arm has moved"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda sim, film: json_of(sim.add_object("cube")), "video: objects or cameras were added or removed"),
        (None, "video: no camera 'nose'"),
    ],
)
def test_a_film_of_another_scene_or_without_its_camera_is_refused(
    sim: SimRobot, tmp_path: Path, change: Callable[[SimRobot, Any], None] | None, text: str
) -> None:
    film = sim.video(tmp_path / "run.gif", width=64, height=48, fps=50, camera=None if change else "nose")
    with pytest.raises(SimulationError, match=text), film:
        assert change is not None
        until(lambda: len(film._poses) > 1, "pictures of the scene")
        change(sim, film)
        filmed = len(film._poses)
        until(lambda: len(film._poses) > filmed + 1, "pictures of the other scene")
    assert not list(tmp_path.iterdir())


def test_seconds_of_a_film_are_a_number_above_zero(sim: SimRobot, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"seconds is 0\. Give a number above 0"):
        sim.video(tmp_path / "run.gif", seconds=0)

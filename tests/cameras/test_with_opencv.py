"""Tests with OpenCV itself: a film in place of a device, JPEG on the mesh, a rover's pictures."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trio
import zenoh

from strands_actors import Robot
from strands_actors.caller.processes.run_directory import notes
from strands_actors.kernel.channels.frame_ring import FrameRing, create
from strands_actors.kernel.channels.zenoh_session import config
from strands_actors.kernel.clock import NS
from strands_actors.surfaces.cameras import Frame, Stale, attach_camera
from strands_actors.surfaces.cameras.compressing import Compressor
from strands_actors.surfaces.cameras.picture_files import ring_path
from tests.answers import status

from .looking import until

STEADY = {"type": "tests.cameras.sources:steady", "fps": 20, "width": 48, "height": 32}


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """Write a film of forty pictures of 64 x 48. The blue value is six times the picture's number."""
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (64, 48))
    for number in range(40):
        image = np.zeros((48, 64, 3), np.uint8)
        image[:, :, 0] = 6 * number  # BGR
        writer.write(image)
    writer.release()
    return path


def test_a_picture_too_large_as_jpeg_costs_itself_alone(tmp_path: Path) -> None:
    path, size = str(tmp_path / "ring"), (1080, 1920, 3)
    create(path, math.prod(size), NS)
    ring = FrameRing(path, writes=True)
    ring.request_compressed(1 << 60)
    compressor = Compressor(ring)
    noise = np.random.default_rng(0).integers(0, 256, size, dtype=np.uint8)
    trio.run(compressor.compress, noise, 1, 1)
    assert "is too large as JPEG" in compressor.problem and ring.newest_compressed == 0
    assert compressor.wants(0)
    trio.run(compressor.compress, np.zeros_like(noise), 2, 2)
    assert compressor.problem == "" and ring.newest_compressed == 2
    ring.close()


@pytest.mark.long
def test_a_film_is_a_camera_that_is_unplugged_at_its_end_and_wanted_as_jpeg(film: Path, run_dir: Path) -> None:
    cameras = {"film": {"index_or_path": str(film), "fps": 20, "width": 64, "height": 48, "warmup_s": 0}}
    with Robot("so101", mode="real", transport="twin", cameras={**cameras, "eye": STEADY}) as arm:
        reader = attach_camera("so101", "film")
        blues = set()

        def seen() -> bool:
            if isinstance(frame := reader.newest(), Frame):
                assert frame.image.shape == (48, 64, 3)
                red, green, blue = frame.image[24, 32].tolist()
                assert red < 20 and green < 20
                blues.add(blue)
            return len(blues) > 3

        until(seen, "pictures of the film")
        until(lambda: isinstance(reader.newest(), Stale), "its end")
        state: dict[str, Any] = status(arm)["cameras"]["film"]
        assert "gives no more pictures" in state["why"] or state["opened"] > 1, state
        until(lambda: status(arm)["cameras"]["film"]["opened"] > 1, "it is opened again")

        (note,) = notes()
        session = zenoh.open(config(connect=note.mesh))
        try:
            got: list[zenoh.Sample] = []
            subscriber = session.declare_subscriber("strands/so101/camera/eye", got.append)
            until(lambda: len(got) > 2, "JPEG comes while somebody subscribes")
            sample = got[-1]
            image = cv2.imdecode(np.frombuffer(sample.payload.to_bytes(), np.uint8), cv2.IMREAD_COLOR)
            assert image.shape == (32, 48, 3)
            assert str(sample.encoding) == "image/jpeg;strands.camera.v1"
            assert sample.attachment is not None
            stamp = json.loads(sample.attachment.to_bytes())
            assert 0 <= time.time_ns() - stamp["time_ns"] < 60e9
            assert stamp["seq"] > 0
            subscriber.undeclare()
            ring = FrameRing(str(ring_path("so101", "eye")))
            until(lambda: ring.requested_until_ns < time.monotonic_ns(), "nobody wants it any more")
            number = ring.newest
            until(lambda: ring.newest > number + 5, "the one that was being compressed is done")
            last = ring.newest_compressed
            until(lambda: ring.newest > number + 15, "pictures go on")
            assert ring.newest_compressed == last, "no further picture is compressed"
        finally:
            session.close()


def test_a_rovers_own_pictures_come_the_same_way(run_dir: Path) -> None:
    cameras = {"front": {"fps": 10}, "back": {"view": "rear", "fps": 10, "rotation": 90}}
    with Robot("earthrover", mode="real", transport="twin", cameras=cameras) as rover:
        for name, shape in (("front", (24, 32, 3)), ("back", (32, 24, 3))):
            reader = attach_camera("earthrover", name)
            frame = until(lambda reader=reader: f if isinstance(f := reader.newest(), Frame) else None, name)
            assert frame.image.shape == shape
            assert 60 < frame.image.mean() < 180
        assert rover.read_camera("front", max_age_ms=5000).sequence > 0

"""The time stamp of a picture of a scene."""

from __future__ import annotations

import time
from typing import Any

import trio

from strands_actors.contract import CameraSettings
from strands_actors.drivers.sim.pictures import ScenePictures


class Late:
    """A twin with a slow answer."""

    scene = -1  # the present scene
    qpos = b""

    async def call(self, *_: Any) -> Late:
        await trio.sleep(0.2)
        return self

    def shoot(self, qpos: bytes, width: int, height: int, view: str) -> bytes:
        return bytes(width * height * 3)


def test_a_picture_is_as_old_as_the_question_for_where_the_joints_are() -> None:
    late: Any = Late()
    camera = ScenePictures(late, CameraSettings(name="front", type="scene", width=4, height=2))
    camera._renderer = late
    picture = trio.run(camera.read)
    assert picture.image.shape == (2, 4, 3)
    assert time.monotonic_ns() - picture.captured_ns >= 200_000_000

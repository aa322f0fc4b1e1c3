"""What a recorder needs of a camera: the newest picture and when it was taken, or that there is
none."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .errors import DatasetError
from .layout import CameraShape

ATTACH = "strands_actors.surfaces.cameras"
FIRST_S = 5.0
"""How long to wait for a camera's first picture."""


class Frame(Protocol):
    """A picture that is fresh enough for whoever took it."""

    @property
    def image(self) -> NDArray[np.uint8]: ...  # rows, columns, red green blue

    @property
    def captured_ns(self) -> int: ...  # CLOCK_MONOTONIC

    @property
    def sequence(self) -> int: ...


class CameraReader(Protocol):
    def newest(self) -> Any:
        """Return a ``Frame``, or something without a picture: the newest one is stale, or there is
        none. Does not wait."""
        ...

    def close(self) -> None: ...


Attach = Callable[[str, str], CameraReader]
"""A robot's name and a camera's."""


def attach_camera(robot: str, camera: str) -> CameraReader:
    """Return a reader of a running robot's camera. Raise ``DatasetError`` when there is none."""
    if find_spec(ATTACH) is None:
        raise DatasetError(f"camera {camera}: this version of strands-actors has no cameras")
    attach: Attach = import_module(ATTACH).attach_camera
    try:
        return attach(robot, camera)
    except Exception as problem:
        raise DatasetError(f"camera {camera} of {robot}: {' '.join(str(problem).split())}") from problem


def frame_of(newest: Any) -> Frame | None:
    """What ``newest`` gave, if it is a picture."""
    return newest if getattr(newest, "image", None) is not None else None


def wait_for_shapes(readers: Mapping[str, CameraReader]) -> Sequence[CameraShape]:
    """Return how large each camera's pictures are, once it has shown one. Raise ``DatasetError`` for
    one that does not."""
    found = []
    deadline = time.monotonic() + FIRST_S
    for name, reader in readers.items():
        while (frame := frame_of(reader.newest())) is None:
            if time.monotonic() > deadline:
                raise DatasetError(f"camera {name} has shown no picture for {FIRST_S:g} s: {reader.newest()}")
            time.sleep(0.02)
        height, width = frame.image.shape[:2]
        found.append(CameraShape(name, height, width))
    return found

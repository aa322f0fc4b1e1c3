"""The interface by which a recorder reads cameras. A camera gives its newest picture with the time, or no
picture."""

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
"""How long to wait for the cameras' first pictures, in seconds."""


class Frame(Protocol):
    """A picture that is new enough to be recorded."""

    @property
    def image(self) -> NDArray[np.uint8]: ...  # Shape (height, width, 3), in the order red, green, blue.

    @property
    def captured_ns(self) -> int: ...  # Time of the picture, in nanoseconds of CLOCK_MONOTONIC.

    @property
    def sequence(self) -> int: ...


class CameraReader(Protocol):
    def newest(self) -> Any:
        """Return the newest picture as a ``Frame``, without waiting. If it is too old or missing, return an
        object that has no ``image`` and explains why."""
        ...

    def close(self) -> None: ...


Attach = Callable[[str, str], CameraReader]
"""Takes the name of a robot and of a camera."""


def attach_camera(robot: str, camera: str) -> CameraReader:
    """Return a reader of a running robot's camera. Raise ``DatasetError`` if there is no such camera."""
    if find_spec(ATTACH) is None:
        raise DatasetError(f"camera {camera}: this version of strands-actors does not support cameras")
    attach: Attach = import_module(ATTACH).attach_camera
    try:
        return attach(robot, camera)
    except Exception as problem:
        raise DatasetError(f"camera {camera} of {robot}: {' '.join(str(problem).split())}") from problem


def frame_of(newest: Any) -> Frame | None:
    """Return a camera reader's result of ``newest`` if it has a picture, otherwise None."""
    return newest if getattr(newest, "image", None) is not None else None


def wait_for_shapes(readers: Mapping[str, CameraReader]) -> Sequence[CameraShape]:
    """Wait for the first picture of each camera, and return their sizes.

    Raises:
        DatasetError: A camera has shown no picture within ``FIRST_S``.
    """
    shapes = []
    deadline = time.monotonic() + FIRST_S
    for name, reader in readers.items():
        while (frame := frame_of(reader.newest())) is None:
            if time.monotonic() > deadline:
                raise DatasetError(f"camera {name} has shown no picture for {FIRST_S:g} s: {reader.newest()}")
            time.sleep(0.02)
        height, width = frame.image.shape[:2]
        shapes.append(CameraShape(name, height, width))
    return shapes

"""Write pictures into an MP4 file. Needs the extra ``dataset``."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from strands_actors.kernel.health.realtime import run_as_before

os.environ.setdefault("SVT_LOG", "1")  # Log only errors. Otherwise the encoder SVT-AV1 prints a banner.

import av
from av.container import OutputContainer
from av.video.stream import VideoStream

PIXELS = "yuv420p"


class Mp4:
    """Encodes pictures of one size into an MP4 file. Picture n is shown at n / fps."""

    def __init__(
        self,
        path: Path,
        encoder: str,
        options: Mapping[str, str],
        size: tuple[int, int],
        fps: int,
        container_options: Mapping[str, str] = {},
        key_every: int | None = None,
    ) -> None:
        """Create the file.

        Args:
            path: The file.
            encoder: FFmpeg's name of the encoder.
            options: The options of the encoder.
            size: Width and height of the pictures in pixels.
            fps: Pictures per second.
            container_options: Further options of the file.
            key_every: Pictures from one key frame to the next. None leaves it to the encoder.

        Raises:
            av.error.FFmpegError: The encoder cannot be used in this way.
            OSError: The file cannot be written.
        """
        self.frames = 0
        self._base = Fraction(1, fps)
        self._container = writer(path, fps, container_options)
        self._stream = cast(VideoStream, self._container.add_stream(encoder, rate=fps, options=dict(options)))
        (self._stream.width, self._stream.height), self._stream.pix_fmt = size, PIXELS
        self._stream.time_base = self._base
        if key_every is not None:
            self._stream.gop_size = key_every
        # If the user is root, SVT-AV1 gives its threads and this thread the real-time priority SCHED_FIFO 99.
        # Undo this.
        with run_as_before():
            # Create the file now, so that unsuitable options raise an exception here.
            self._container.start_encoding()

    def add(self, picture: NDArray[np.uint8]) -> None:
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        frame.pts, frame.time_base = self.frames, self._base
        self.frames += 1
        self._container.mux(self._stream.encode(frame))

    def finish(self) -> None:
        """Encode the last pictures, and close the file."""
        self._container.mux(self._stream.encode())
        self._container.close()

    def abandon(self) -> None:
        """Close the file without the last pictures."""
        with contextlib.suppress(OSError):  # If the disk is full, the rest cannot be written.
            self._container.close()


def writer(path: Path, timescale: int, options: Mapping[str, str]) -> OutputContainer:
    """Open an MP4 file for writing.

    Args:
        path: The file.
        timescale: Time units per second.
        options: The options of the file.
    """
    # Pass a path, so that the library writes the file itself. With a Python file object, a container that is
    # not closed would crash the process.
    return av.open(str(path), "w", format="mp4", options={**options, "video_track_timescale": str(timescale)})

"""Pictures to MP4 and back. No encoder under the GPL: see ``CODECS``."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from strands_actors.contract.shown import shown
from strands_actors.kernel.health.realtime import run_as_before

from .errors import DatasetError
from .layout import CameraShape

os.environ.setdefault("SVT_LOG", "1")  # errors only: the encoder greets on stderr otherwise

import av
from av.container import OutputContainer
from av.video.stream import VideoStream

VideoError = av.error.FFmpegError

PIXELS = "yuv420p"
KEY_EVERY = 2
"""Frames from one key frame to the next: training reads single frames, anywhere."""
FRAGMENT_S = 0.5
"""What a recorder that is killed has not written yet."""


QUALITY_UNIT = 118
"""FFmpeg's, of one step of a quantiser."""


class Codec(msgspec.Struct, frozen=True):
    """``name``: as ``info.json`` and the decoders call it."""

    name: str
    encoder: str
    options: dict[str, str]
    least: int  # pixels of a side


CODECS = {
    "av1": Codec(
        "av1",
        "libsvtav1",  # BSD; LeRobot's own default
        {"preset": "13", "crf": "30", "svtav1-params": "lp=1:pred-struct=1"},  # each frame leaves at once
        64,
    ),
    "mpeg4": Codec(
        "mpeg4", "mpeg4", {"flags": "+qscale", "global_quality": str(4 * QUALITY_UNIT)}, 16
    ),  # FFmpeg's own, LGPL: a third of the time, larger
}
DEFAULT = "av1"


def require_codec(name: str, cameras: Sequence[CameraShape]) -> Codec:
    """Raise ``DatasetError`` for a codec that there is not, or that cannot have such pictures."""
    if not isinstance(name, str) or name not in CODECS:
        raise DatasetError(f"there is no codec {shown(name)}. use {' or '.join(CODECS)}")
    codec = CODECS[name]
    for camera in cameras:
        if camera.height % 2 or camera.width % 2 or min(camera.height, camera.width) < codec.least:
            raise DatasetError(
                f"{camera.name}: pictures of {camera.width}x{camera.height}. "
                f"{name} needs even sides of {codec.least} pixels or more"
            )
    return codec


class Encoder:
    """Writes the pictures of one camera into a fragmented MP4: what has been written is readable,
    whatever becomes of the rest. Frame n is shown at n / fps."""

    def __init__(self, path: Path, camera: CameraShape, fps: int, codec: str) -> None:
        how = require_codec(codec, [camera])
        self._shape = (camera.height, camera.width, 3)
        self._base = Fraction(1, fps)
        options = {
            "movflags": "empty_moov+default_base_moof",
            "frag_duration": str(int(FRAGMENT_S * 1e6)),
            "flush_packets": "1",  # a fragment that waits in a buffer of ours dies with us
        }
        self._container = _writer(path, fps, options)
        self._stream = cast(VideoStream, self._container.add_stream(how.encoder, rate=fps, options=how.options))
        self._stream.width, self._stream.height, self._stream.pix_fmt = camera.width, camera.height, PIXELS
        self._stream.time_base = self._base
        self._stream.gop_size = KEY_EVERY
        with run_as_before():  # run by root, SVT-AV1 puts its threads and this one at SCHED_FIFO 99
            self._container.start_encoding()  # the file is there, and what the encoder does not take is refused now
        self.frames = 0

    def add(self, picture: NDArray[np.uint8]) -> None:
        if picture.shape != self._shape:
            raise DatasetError(f"a picture of {picture.shape}; the camera began with {self._shape}")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        frame.pts, frame.time_base = self.frames, self._base
        self.frames += 1
        self._container.mux(self._stream.encode(frame))

    def finish(self) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()

    def abandon(self) -> None:
        """What was written stays."""
        with contextlib.suppress(OSError):  # a full disk: there is nothing more to write
            self._container.close()


def _writer(path: Path, fps: int, options: dict[str, str]) -> OutputContainer:
    # The library writes by itself: one that is left open and writes into a file of Python's ends the process.
    return av.open(str(path), "w", format="mp4", options=options | {"video_track_timescale": str(fps)})


def remux(source: Path, path: Path, fps: int, frames: int) -> int:
    """Write the first ``frames`` frames as an ordinary MP4, which begins with its index, without
    encoding them again. Return how many there were."""
    return concatenate([source], path, fps, [frames])


def concatenate(sources: Sequence[Path], path: Path, fps: int, frames: Sequence[int]) -> int:
    """Write the first ``frames`` of each source one behind the other."""
    before = 0
    with _writer(path, fps, {"movflags": "faststart"}) as container:
        stream: Any = None
        for source, wanted in zip(sources, frames, strict=True):
            with contextlib.closing(av.open(str(source))) as opened:
                stream = stream or container.add_stream_from_template(opened.streams.video[0], opaque=True)
                taken = 0
                for packet in _packets(opened, fps):
                    if taken == wanted:
                        break
                    packet.stream = stream
                    packet.pts = packet.dts = before + taken
                    packet.duration = 1
                    packet.time_base = Fraction(1, fps)
                    container.mux(packet)
                    taken += 1
            before += taken
    return before


def _packets(container: Any, fps: int) -> Iterator[Any]:
    """In order, one a frame. The end of a file that was cut off is where it was cut off."""
    try:
        for packet in container.demux(video=0):
            if packet.is_corrupt:  # it was cut off within this one
                return
            if packet.size:
                yield packet
    except (av.error.InvalidDataError, av.error.EOFError):
        return


def count_frames(path: Path, fps: int) -> int:
    """Return how many frames can be read; 0: it is no video, or not yet one."""
    try:
        with contextlib.closing(av.open(str(path))) as container:
            return sum(1 for _ in _packets(container, fps)) if container.streams.video else 0
    except (av.error.InvalidDataError, av.error.EOFError, FileNotFoundError):
        return 0


def setup_of(path: Path) -> bytes:
    """Return what a decoder is told before the first frame: videos are joined when it is the
    same."""
    with contextlib.closing(av.open(str(path))) as container:
        stream = container.streams.video[0]
        return bytes(stream.codec_context.extradata or b"") + f"{stream.width}x{stream.height}".encode()


def pictures_of(path: Path) -> Iterator[NDArray[np.uint8]]:
    """Decode a video."""
    with contextlib.closing(av.open(str(path))) as container:
        for frame in container.decode(video=0):
            yield cast(NDArray[np.uint8], frame.to_ndarray(format="rgb24"))

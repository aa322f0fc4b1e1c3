"""Pictures to MP4 and back. No encoder under the GPL: see ``CODECS``."""

from __future__ import annotations

import contextlib
import errno
import os
import zlib
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import IO, Any, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from strands_actors.contract.shown import shown
from strands_actors.kernel.health.realtime import run_as_before

from .errors import DatasetError
from .layout import CameraShape
from .tables import unreadable

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


DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
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


def _writer(path: Path, timescale: int, options: dict[str, str]) -> OutputContainer:
    # The library writes by itself: one that is left open and writes into a file of Python's ends the process.
    return av.open(str(path), "w", format="mp4", options=options | {"video_track_timescale": str(timescale)})


class Pictures(msgspec.Struct, frozen=True):
    """What the index of a video counts, where its file is long enough for it."""

    count: int
    height: int
    width: int
    codec: str
    seconds: float  # from the first picture to the last


class Span(msgspec.Struct, frozen=True):
    """The pictures of one episode in a video."""

    path: Path
    first: int
    frames: int


def rate_of(fps: float) -> Fraction:
    """Return a rate as a fraction: 29.97 is 2997/100."""
    return Fraction(str(fps)).limit_denominator(1001)


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[tuple[Any, VideoStream]]:
    """Open a video. Raise ``DatasetError`` when it is missing or damaged."""
    try:
        with contextlib.closing(av.open(str(path))) as container:
            if not container.streams.video:
                raise DatasetError(f"{path} has no pictures")
            if container.streams.video[0].codec_context is None:
                raise DatasetError(f"{path} has pictures of a codec that is not known")
            yield container, container.streams.video[0]
    except FileNotFoundError as missing:
        raise DatasetError(f"{path} is missing") from missing
    except (VideoError, OSError, ValueError, OverflowError, MemoryError) as damage:
        if getattr(damage, "errno", None) in DISK:  # of a file that is being written
            raise
        raise DatasetError(unreadable(path, damage)) from damage


def look(path: Path) -> Pictures:
    """Read a video's index, and its end: an index that counts more than the file has is not believed.

    Raises:
        DatasetError: It is missing or damaged.
    """
    with _reading(path) as (container, stream):
        size = stream.height, stream.width, stream.codec_context.codec.canonical_name
        base, start = stream.time_base or Fraction(1), stream.start_time or 0
        container.seek(max(0, (stream.duration or 0) + start), stream=stream)
        last = max((packet.pts or 0 for packet in _packets(container)), default=None)
        if stream.frames and last is not None:
            return Pictures(stream.frames, *size, float((last - start) * base))
    with _reading(path) as (container, stream):  # fragments, or a file that was cut off
        times = [packet.pts or 0 for packet in _packets(container)]
        seconds = float((max(times, default=start) - start) * base)
        return Pictures(len(times), *size, seconds)


def remux(source: Path, path: Path, fps: int, frames: int) -> int:
    """Write the first ``frames`` frames as an ordinary MP4, which begins with its index, without
    encoding them again. Return their checksum."""
    return concatenate([Span(source, 0, frames)], path, fps)[0]


def concatenate(spans: Sequence[Span], path: Path, fps: float) -> list[int]:
    """Write the pictures of each span one behind the other, without encoding them again.

    Returns:
        A checksum of the pictures of each span.

    Raises:
        DatasetError: A source is damaged, has too few pictures, or cannot be cut there.
    """
    rate = rate_of(fps)
    sums = []
    before = 0
    with _writer(path, rate.numerator, {"movflags": "faststart"}) as container:
        stream: Any = None
        for span in spans:
            with _reading(span.path) as (opened, source):
                stream = stream or container.add_stream_from_template(source, opaque=True)
                delay = source.codec_context.has_b_frames
                checksum = 0
                for order, (number, packet) in enumerate(_numbered(_packets(opened), source, span, rate)):
                    checksum = zlib.crc32(packet, checksum)
                    packet.stream = stream
                    packet.time_base = Fraction(1, rate.numerator)
                    packet.pts = (before + number) * rate.denominator
                    packet.dts = (before + order - delay) * rate.denominator
                    packet.duration = rate.denominator
                    container.mux(packet)
            sums.append(checksum)
            before += span.frames
    return sums


def checksums(path: Path, spans: Sequence[tuple[int, int]], fps: float) -> list[int | None]:
    """Read the pictures of spans, without decoding them.

    Args:
        path: The video.
        spans: For each span its first picture and how many it has, in their order.
        fps: Pictures a second.

    Returns:
        For each span what ``concatenate`` returned for it; None when a picture of it is not there.
    """
    found: list[int | None] = [None] * len(spans)
    with contextlib.suppress(DatasetError), _reading(path) as (container, stream):
        packets = _packets(container)
        for at, (first, count) in enumerate(spans):
            checksum = 0
            for _, packet in _numbered(packets, stream, Span(path, first, count), rate_of(fps)):
                checksum = zlib.crc32(packet, checksum)
            found[at] = checksum
    return found


def _numbered(packets: Iterator[Any], stream: VideoStream, span: Span, rate: Fraction) -> Iterator[tuple[int, Any]]:
    """The packets of a span in the order of decoding, each with the number of its picture in the span."""
    base, start = stream.time_base or Fraction(1), stream.start_time or 0
    missing = set(range(span.frames))
    for packet in packets:
        number = round(((packet.pts or 0) - start) * base * rate) - span.first
        if number not in missing:
            continue
        if len(missing) == span.frames and not packet.is_keyframe:
            raise DatasetError(f"{span.path} cannot be cut at picture {span.first}: it is no key frame")
        missing.discard(number)
        yield number, packet
        if not missing:
            return
    raise DatasetError(
        f"{span.path} has {span.frames - len(missing)} pictures of {span.frames} from {span.first} on"
    )


def _packets(container: Any) -> Iterator[Any]:
    """In order, one a frame. The end of a file that was cut off is where it was cut off."""
    try:
        for packet in container.demux(video=0):
            if packet.is_corrupt:  # it was cut off within this one
                return
            if packet.size:
                yield packet
    except (av.error.InvalidDataError, av.error.EOFError):
        return


def count_frames(path: Path) -> int:
    """Return how many frames can be read; 0: it is no video, or not yet one."""
    try:
        with contextlib.closing(av.open(str(path))) as container:
            return sum(1 for _ in _packets(container)) if container.streams.video else 0
    except (av.error.InvalidDataError, av.error.EOFError, FileNotFoundError):
        return 0


def setup_of(path: Path) -> bytes:
    """Return what a decoder is told before the first frame: videos are joined when it is the
    same."""
    with _reading(path) as (_, stream):
        setup = bytes(stream.codec_context.extradata or b"")
        return setup + f"{stream.width}x{stream.height} {stream.codec_context.codec.canonical_name}".encode()


def pictures_of(path: Path) -> Iterator[NDArray[np.uint8]]:
    """Decode a video. Raise ``DatasetError`` when it is missing or damaged."""
    with _reading(path) as (container, _):
        for frame in container.decode(video=0):
            yield cast(NDArray[np.uint8], frame.to_ndarray(format="rgb24"))


def decode_image(file: IO[bytes]) -> NDArray[np.uint8]:
    """Decode one picture of a file of pictures. Raise ``DatasetError`` when it is damaged."""
    try:
        with contextlib.closing(av.open(file, "r")) as container:
            return cast(NDArray[np.uint8], next(container.decode(video=0)).to_ndarray(format="rgb24"))
    except (VideoError, StopIteration, IndexError, ValueError) as damage:
        raise DatasetError(f"a picture cannot be read: {damage}") from damage

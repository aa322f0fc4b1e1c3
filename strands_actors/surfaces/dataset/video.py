"""Encode pictures into MP4 files, cut and join such files, and decode them. The encoders in ``CODECS`` are not
under the GPL."""

from __future__ import annotations

import contextlib
import errno
import zlib
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import IO, Any, cast

import av
import msgspec
import numpy as np
from av.video.stream import VideoStream
from numpy.typing import NDArray

from strands_actors.contract.shown import shown
from strands_actors.simulation.mp4 import Mp4, writer

from .errors import DatasetError
from .layout import CameraShape
from .tables import unreadable

VideoError = av.error.FFmpegError

KEY_EVERY = 2
"""Frames from one key frame to the next. It is small because training reads single frames at random."""
FRAGMENT_S = 0.5
"""Length of a fragment in seconds. A killed recorder loses at most so much."""


DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)
"""Errors of the disk, not of the video."""
QUALITY_UNIT = 118
"""FFmpeg's ``global_quality`` for one step of the quantiser."""


class Codec(msgspec.Struct, frozen=True):
    """A video codec and the encoder for it. ``name`` is the name in ``info.json`` and for decoders."""

    name: str
    encoder: str
    options: dict[str, str]
    least: int  # Least width and height of a picture, in pixels.


CODECS = {
    "av1": Codec(
        "av1",
        "libsvtav1",  # This encoder has the BSD license, and is LeRobot's default.
        # Pred-struct=1 means low delay: the encoder returns each frame at once.
        {"preset": "13", "crf": "30", "svtav1-params": "lp=1:pred-struct=1"},
        64,
    ),
    "mpeg4": Codec(
        "mpeg4", "mpeg4", {"flags": "+qscale", "global_quality": str(4 * QUALITY_UNIT)}, 16
    ),  # FFmpeg's encoder (LGPL) takes a third of the time of libsvtav1. Its files are larger.
}
DEFAULT = "av1"


def require_codec(name: str, cameras: Sequence[CameraShape]) -> Codec:
    """Return a codec by name.

    Raises:
        DatasetError: The codec is not known, or it cannot encode pictures of a camera's size.
    """
    if not isinstance(name, str) or name not in CODECS:
        raise DatasetError(f"there is no codec {shown(name)}. Use {' or '.join(CODECS)}")
    codec = CODECS[name]
    for camera in cameras:
        if camera.height % 2 or camera.width % 2 or min(camera.height, camera.width) < codec.least:
            raise DatasetError(
                f"camera {camera.name} has pictures of {camera.width}x{camera.height}, "
                f"but {name} needs an even width and height of {codec.least} pixels or more. Use another size"
            )
    return codec


class Encoder:
    """Writes the pictures of one camera into a fragmented MP4.

    Complete fragments stay readable if the process is killed. Frame n is shown at n / fps.
    """

    def __init__(self, path: Path, camera: CameraShape, fps: int, codec: str) -> None:
        spec = require_codec(codec, [camera])
        self._shape = (camera.height, camera.width, 3)
        options = {
            "movflags": "empty_moov+default_base_moof",
            "frag_duration": str(int(FRAGMENT_S * 1e6)),
            # Write each fragment at once. If this process is killed, buffered data would be lost.
            "flush_packets": "1",
        }
        size = camera.width, camera.height
        self._file = Mp4(path, spec.encoder, spec.options, size, fps, options, KEY_EVERY)

    @property
    def frames(self) -> int:
        return self._file.frames

    def add(self, picture: NDArray[np.uint8]) -> None:
        if picture.shape != self._shape:
            raise DatasetError(
                f"a picture has the shape {picture.shape}, but the camera's first picture had {self._shape}"
            )
        self._file.add(picture)

    def finish(self) -> None:
        self._file.finish()

    def abandon(self) -> None:
        """Close the file. The fragments that were written stay readable."""
        self._file.abandon()


class Pictures(msgspec.Struct, frozen=True):
    """The number, size and codec of the pictures in a video file."""

    count: int
    height: int
    width: int
    codec: str
    seconds: float  # Time from the first picture to the last, in seconds.


class Span(msgspec.Struct, frozen=True):
    """The pictures of one episode in a video: the file, the number of the first picture, and the number of
    pictures."""

    path: Path
    first: int
    frames: int


def rate_of(fps: float) -> Fraction:
    """Return a rate as a fraction: 29.97 is 2997/100."""
    return Fraction(str(fps)).limit_denominator(1001)


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[tuple[Any, VideoStream]]:
    """Open a video. Raise ``DatasetError`` if it is missing or damaged."""
    try:
        with contextlib.closing(av.open(str(path))) as container:
            if not container.streams.video:
                raise DatasetError(f"{path} has no pictures")
            if container.streams.video[0].codec_context is None:
                raise DatasetError(f"{path} has a codec that is not known")
            yield container, container.streams.video[0]
    except FileNotFoundError as missing:
        raise DatasetError(f"{path} is missing") from missing
    except (VideoError, OSError, ValueError, OverflowError, MemoryError) as damage:
        # The disk of the file that is being written has failed, so the video is not damaged.
        if getattr(damage, "errno", None) in DISK:
            raise
        raise DatasetError(unreadable(path, damage)) from damage


def look(path: Path) -> Pictures:
    """Return the number, size and codec of a video's pictures.

    The end of the file is read, too. So it is noticed if the video's index lists more pictures than the file
    has.

    Raises:
        DatasetError: The video is missing or damaged.
    """
    with _reading(path) as (container, stream):
        size = stream.height, stream.width, stream.codec_context.codec.canonical_name
        base, start = stream.time_base or Fraction(1), stream.start_time or 0
        container.seek(max(0, (stream.duration or 0) + start), stream=stream)
        last = max((packet.pts or 0 for packet in _packets(container)), default=None)
        if stream.frames and last is not None:
            return Pictures(stream.frames, *size, float((last - start) * base))
    with _reading(path) as (container, stream):  # The file is fragmented or truncated, so count its packets.
        times = [packet.pts or 0 for packet in _packets(container)]
        seconds = float((max(times, default=start) - start) * base)
        return Pictures(len(times), *size, seconds)


def remux(source: Path, path: Path, fps: int, frames: int) -> int:
    """Copy the first ``frames`` frames of a fragmented MP4 into an ordinary MP4, without encoding them again.
    Return a checksum of the frames."""
    return concatenate([Span(source, 0, frames)], path, fps)[0]


def concatenate(spans: Sequence[Span], path: Path, fps: float) -> list[int]:
    """Join the pictures of several spans in one video, without encoding them again.

    Returns:
        A checksum of the pictures of each span.

    Raises:
        DatasetError: A source is damaged, has too few pictures, or has no key frame at the beginning of a span.
    """
    rate = rate_of(fps)
    sums = []
    before = 0
    with writer(path, rate.numerator, {"movflags": "faststart"}) as container:
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
    """Return checksums of the pictures of spans, without decoding them.

    Args:
        path: The video.
        spans: For each span, the number of its first picture and how many pictures it has. In ascending order.
        fps: Pictures per second.

    Returns:
        For each span, the same checksum as ``concatenate`` returns. None if a picture is missing.
    """
    sums: list[int | None] = [None] * len(spans)
    with contextlib.suppress(DatasetError), _reading(path) as (container, stream):
        packets = _packets(container)
        for index, (first, count) in enumerate(spans):
            checksum = 0
            for _, packet in _numbered(packets, stream, Span(path, first, count), rate_of(fps)):
                checksum = zlib.crc32(packet, checksum)
            sums[index] = checksum
    return sums


def _numbered(packets: Iterator[Any], stream: VideoStream, span: Span, rate: Fraction) -> Iterator[tuple[int, Any]]:
    """Yield the packets (encoded pictures) of a span in decoding order, each with the number of its picture in
    the span."""
    base, start = stream.time_base or Fraction(1), stream.start_time or 0
    missing = set(range(span.frames))
    for packet in packets:
        number = round(((packet.pts or 0) - start) * base * rate) - span.first
        if number not in missing:
            continue
        if len(missing) == span.frames and not packet.is_keyframe:
            raise DatasetError(
                f"{span.path} cannot be cut at picture {span.first}, because this is not a key frame"
            )
        missing.discard(number)
        yield number, packet
        if not missing:
            return
    raise DatasetError(
        f"{span.path} has only {span.frames - len(missing)} of "
        f"the {span.frames} pictures from number {span.first} on"
    )


def _packets(container: Any) -> Iterator[Any]:
    """Yield the packets in order, one per frame, up to the end of the file or the place where it was cut
    off."""
    try:
        for packet in container.demux(video=0):
            if packet.is_corrupt:  # The file ends within this packet.
                return
            if packet.size:
                yield packet
    except (av.error.InvalidDataError, av.error.EOFError):
        return


def count_frames(path: Path) -> int:
    """Return how many frames can be read. 0 if the file is not a video, or does not have a complete frame
    yet."""
    try:
        with contextlib.closing(av.open(str(path))) as container:
            return sum(1 for _ in _packets(container)) if container.streams.video else 0
    except (av.error.InvalidDataError, av.error.EOFError, FileNotFoundError):
        return 0


def setup_of(path: Path) -> bytes:
    """Return the setup data for the decoder, with the size and the codec. Videos can be joined only if their
    setup data is equal."""
    with _reading(path) as (_, stream):
        setup = bytes(stream.codec_context.extradata or b"")
        return setup + f"{stream.width}x{stream.height} {stream.codec_context.codec.canonical_name}".encode()


def pictures_of(path: Path) -> Iterator[NDArray[np.uint8]]:
    """Decode a video. Raise ``DatasetError`` if it is missing or damaged."""
    with _reading(path) as (container, _):
        for frame in container.decode(video=0):
            yield cast(NDArray[np.uint8], frame.to_ndarray(format="rgb24"))


def decode_image(file: IO[bytes]) -> NDArray[np.uint8]:
    """Decode an image file. Raise ``DatasetError`` if it is damaged."""
    try:
        with contextlib.closing(av.open(file, "r")) as container:
            return cast(NDArray[np.uint8], next(container.decode(video=0)).to_ndarray(format="rgb24"))
    except (VideoError, StopIteration, IndexError, ValueError) as damage:
        raise DatasetError(f"a picture cannot be read: {damage}") from damage


def encode_image(picture: NDArray[np.uint8], width: int) -> bytes:
    """Return a picture as a JPEG of about this width in pixels."""
    height = max(2, round(width * picture.shape[0] / picture.shape[1] / 2) * 2)
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
    encoder = cast(Any, av.CodecContext.create("mjpeg", "w"))
    encoder.width, encoder.height, encoder.pix_fmt, encoder.time_base = width, height, "yuvj420p", Fraction(1)
    packets = encoder.encode(frame.reformat(width=width, height=height, format="yuvj420p"))
    return b"".join(map(bytes, [*packets, *encoder.encode(None)]))

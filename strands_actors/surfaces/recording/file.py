"""Write and read the MCAP file of a recording. It has JSON rows for people, their schemas, and the journal (the
robot's internal messages) for replays."""

from __future__ import annotations

import json
import os
import struct
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import msgspec

from strands_actors.contract.extras import require

# If a package is missing, this error names the extra to install. The imports below would name only a module.
require("record", "a recording")

import zstandard  # noqa: E402
from mcap.exceptions import McapError  # noqa: E402
from mcap.records import Channel as McapChannel  # noqa: E402
from mcap.records import Chunk, McapRecord, Message, Metadata  # noqa: E402
from mcap.stream_reader import StreamReader, breakup_chunk  # noqa: E402
from mcap.writer import Writer  # noqa: E402

from strands_actors.contract.shown import harmless, shown  # noqa: E402
from strands_actors.supervisors.instrument import FORMAT, Attached, Batch, Entry  # noqa: E402
from strands_actors.version import __version__  # noqa: E402

from .arguments import path_of  # noqa: E402
from .errors import RecordingError  # noqa: E402
from .rows import CHANNELS, SCHEMA_NAMES, Gap, Journal, schema  # noqa: E402
from .views import Row, View, decode_entries  # noqa: E402

METADATA = "strands-actors"
CHUNK_BYTES = 64 * 1024
"""Size of a chunk: about a second, which is lost if the recorder is killed."""
MAX_CHUNK_BYTES = 16 << 20
"""Largest chunk that is read. A chunk ends with the first message beyond ``CHUNK_BYTES``."""
FLOOR_BYTES, MOST_COMPRESSED = 1 << 20, 100
"""Largest decompressed size of a whole file: this many bytes, or this many times its size. Recordings of
this package reach 10 to 20 times."""
END = b"\x89MCAP0\r\n"

encode_json = msgspec.json.Encoder().encode


class Info(msgspec.Struct, frozen=True):
    """The description of a recording in its file.

    Attributes:
        format: The format of the journal (the robot's internal messages).
        version: The version of this package.
        robot: The name of the robot.
        code: The fingerprint of the code that made the decisions (``code.fingerprint``).
        wall_ns: Wall-clock time minus the robot's clock, in nanoseconds.
        attached: The robot's answer to the recorder, which describes its driver and axes.
    """

    format: int
    version: str
    robot: str
    code: str
    wall_ns: int
    attached: Attached

    @property
    def kind(self) -> str:
        return str(self.attached.driver["robot"])


class Recording(msgspec.Struct):
    """A recording as a replay needs it: the journal (internal messages) of the wire process, which communicates
    with the robot, and the gaps in the journal, in their order."""

    info: Info
    parts: list[Journal | Gap]


class RecordingFile:
    """Write a recording. Only the user can read the file, since it has every message to the robot.

    Args:
        path: The new file. An existing file is not overwritten.
        info: The description of the recording.

    Raises:
        OSError: The file exists already, or cannot be written.
    """

    def __init__(self, path: Path, info: Info) -> None:
        self.path = path
        self.counts: Counter[str] = Counter()
        self._robot = info.robot
        self._wall_ns = info.wall_ns
        self._stream: IO[bytes] = os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb")
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES)
        self._writer.start(profile="", library=f"strands-actors {info.version}")
        self._writer.add_metadata(METADATA, {"info": msgspec.json.encode(info).decode()})
        self._channels = {name: self._channel(name, row) for name, row in CHANNELS.items()}
        self._views = {name: View(name, info.attached.axes, info.wall_ns) for name in ("wire", "root")}
        self.flush()

    def _channel(self, name: str, row: type[msgspec.Struct]) -> int:
        full_name = SCHEMA_NAMES.get(name, f"strands_actors.{row.__name__}")
        schema_id = self._writer.register_schema(full_name, "jsonschema", json.dumps(schema(row)).encode())
        return self._writer.register_channel(f"/{self._robot}/{name}", "json", schema_id)

    def add(self, source: str, batch: Batch) -> None:
        data = msgspec.msgpack.encode(batch.entries)
        if batch.entries:
            journal = Journal(source, batch.session, batch.number, data)
            self._write("journal", time.monotonic_ns(), journal)
        self._rows(self._views[source].rows(decode_entries(data)))

    def lost(self, source: str, reason: str) -> None:
        """Record that a process has stopped sending its journal (its internal messages)."""
        self._rows(self._views[source].lost(time.monotonic_ns(), reason))

    def flush(self) -> None:
        self._stream.flush()

    def close(self) -> None:
        try:
            for view in self._views.values():
                self._rows(view.end())
            self._writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it open
        finally:
            self._stream.close()

    def _rows(self, rows: Iterator[Row]) -> None:
        for channel, at_ns, row in rows:
            self._write(channel, at_ns, row)

    def _write(self, channel: str, at_ns: int, row: msgspec.Struct) -> None:
        self.counts[channel] += 1
        log_time = at_ns + self._wall_ns
        self._writer.add_message(self._channels[channel], log_time, encode_json(row), log_time)


def new_info(robot: str, code: str, attached: Attached) -> Info:
    return Info(FORMAT, __version__, robot, code, time.time_ns() - time.monotonic_ns(), attached)


def read(path: str | os.PathLike[str]) -> Recording:
    """Read a recording.

    Raises:
        RecordingError: ``path`` is not a path, or the file is damaged or not a recording of this package.
        OSError: The file cannot be read.
    """
    path = path_of("read", "path", path)
    with path.open("rb") as stream:
        try:
            return _read(path, stream)
        except RecordingError:
            raise
        except _DAMAGE as damage:
            raise RecordingError(
                f"{path} is damaged: {' '.join(str(damage).split()) or type(damage).__name__}"
            ) from damage


_DAMAGE: tuple[type[Exception], ...] = (
    McapError, msgspec.MsgspecError, struct.error, zstandard.ZstdError, ValueError, KeyError, IndexError,
    RuntimeError, EOFError, MemoryError, OverflowError,
)  # fmt: skip
"""The exceptions of the reader, the decompressors and the decoders for damaged bytes."""


def _read(path: Path, stream: IO[bytes]) -> Recording:
    if stream.read(len(END)) != END:
        raise RecordingError(f"{path} is not an MCAP file")
    stream.seek(0, 2)
    size = stream.tell()
    stream.seek(max(0, size - len(END)))
    if size < 2 * len(END) or stream.read() != END:
        raise RecordingError(f"{path} is truncated, probably because the recorder was killed")
    stream.seek(0)
    info: Info | None = None
    topics: dict[int, str] = {}
    parts: list[Journal | Gap] = []
    for record in _records(path, stream, size):
        if isinstance(record, Metadata) and record.name == METADATA:
            info = _info(path, record.metadata)
        elif isinstance(record, McapChannel):
            topics[record.id] = record.topic.rpartition("/")[2]
        elif isinstance(record, Message):
            topic = topics[record.channel_id]
            if topic == "journal":
                journal = msgspec.json.decode(record.data, type=Journal)
                if journal.source == "wire":
                    parts.append(journal)
            elif topic == "gap":
                gap = msgspec.json.decode(record.data, type=Gap)
                if gap.source == "wire" and gap.missing < 0:  # Gaps of a known length are also in the journal.
                    parts.append(gap)
    if info is None:
        raise RecordingError(f"{path} is not a recording of strands-actors")
    return Recording(info, parts)


def _records(path: Path, stream: IO[bytes], size: int) -> Iterator[McapRecord]:
    """Yield the records of a file. Limit the size of decompressed chunks, so that a small malicious file cannot
    fill the memory."""
    most = max(FLOOR_BYTES, MOST_COMPRESSED * size)
    for record in StreamReader(stream, emit_chunks=True, record_size_limit=size).records:
        if not isinstance(record, Chunk):
            yield record
            continue
        length = record.uncompressed_size
        if record.compression == "zstd":
            length = max(length, zstandard.frame_content_size(record.data))
        elif record.compression:
            raise RecordingError(f"{path}: the compression {shown(record.compression)} is not supported, only zstd")
        most -= length
        if length > MAX_CHUNK_BYTES or most < 0:
            raise RecordingError(f"{path} is damaged: its {size} bytes would decompress to too many bytes")
        yield from breakup_chunk(record, validate_crc=True)


def _info(path: Path, metadata: dict[str, str]) -> Info:
    plain: Any = msgspec.json.decode(metadata["info"])
    if plain.get("format") != FORMAT:
        written, form = (harmless(str(plain.get(name))[:40]) for name in ("version", "format"))
        raise RecordingError(
            f"{path} has format {form}, written by strands-actors {written}. This version reads format {FORMAT}"
        )
    return msgspec.json.decode(metadata["info"], type=Info)


def entries_of(journal: Journal) -> Sequence[Entry]:
    return decode_entries(journal.entries)

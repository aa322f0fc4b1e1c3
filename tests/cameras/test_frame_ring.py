"""The file that holds pictures: one process writes it, any number of processes read, and no one waits."""

from __future__ import annotations

import errno
import multiprocessing
import os
import tempfile
import time
from pathlib import Path
from typing import NoReturn

import pytest

from strands_actors.kernel.channels.frame_ring import (
    COMPRESSED_ROOM,
    FRONT,
    HEAD,
    PAGE,
    SLOTS,
    FrameRing,
    NoRing,
    Shot,
    create,
)
from strands_actors.surfaces.cameras.picture_files import SHARED

SIDE = 256
BYTES = SIDE * SIDE * 3


@pytest.fixture
def path(tmp_path: Path) -> str:
    create(str(tmp_path / "ring"), BYTES, 200_000_000)
    return str(tmp_path / "ring")


def put(ring: FrameRing, value: int, captured_ns: int = 0) -> int:
    return ring.put(captured_ns or time.monotonic_ns(), SIDE, SIDE, memoryview(bytes([value]) * BYTES))


def test_a_reader_gets_the_last_picture(path: str) -> None:
    writer, reader = FrameRing(path, writes=True), FrameRing(path)
    assert reader.read() is None
    assert (reader.newest, reader.captured_ns, reader.stale_ns) == (0, 0, 200_000_000)
    for number in range(1, 3 * SLOTS):
        assert put(writer, number, 1000 + number) == number
        assert reader.read() == Shot(number, 1000 + number, SIDE, SIDE, bytearray([number]) * BYTES)
        assert reader.captured_ns == 1000 + number


def test_a_picture_is_whole_at_any_rate_of_replacement(path: str) -> None:
    """All bytes of a picture are equal. A picture that was read while it was written would have two values."""
    reader = FrameRing(path)
    numbers = set()
    other = multiprocessing.get_context("fork").Process(target=_write_for, args=(path, 1.0))
    other.start()
    try:
        while other.is_alive():
            shot = reader.read()
            if shot is not None:
                assert len(set(bytes(shot.data))) == 1
                numbers.add(shot.number)
    finally:
        other.kill()
        other.join()
    assert len(numbers) > 3


def _write_for(path: str, seconds: float) -> None:
    ring = FrameRing(path, writes=True)
    until_s, value = time.monotonic() + seconds, 0
    while time.monotonic() < until_s:
        value = (value + 1) % 256
        put(ring, value)


def test_a_writer_that_ends_in_the_middle_leaves_the_picture_before_it(path: str) -> None:
    writer, reader = FrameRing(path, writes=True), FrameRing(path)
    for value in range(1, 6):
        put(writer, value)
    # This is the state after a process was killed while it wrote number 6.
    slot = FRONT + (6 % SLOTS) * (HEAD + BYTES)
    with open(path, "r+b") as file:
        file.seek(slot)
        file.write((11).to_bytes(8, "little"))
        file.seek(slot + HEAD)
        file.write(b"\xff" * 1000)
    shot = reader.read()
    assert shot is not None
    assert (shot.number, set(shot.data)) == (5, {5})
    successor = FrameRing(path, writes=True)
    assert put(successor, 7) == 6
    shot = reader.read()
    assert shot is not None
    assert (shot.number, set(shot.data)) == (6, {7})


def test_a_picture_that_is_too_large_is_refused_by_its_size(path: str) -> None:
    writer = FrameRing(path, writes=True)
    with pytest.raises(ValueError, match=r"a picture of 512 x 256 is 393216 bytes, but the room .* Give width and"):
        writer.put(1, 256, 512, memoryview(bytes(256 * 512 * 3)))
    assert writer.newest == 0


def test_a_new_ring_takes_no_memory_before_its_use(tmp_path: Path) -> None:
    path = str(tmp_path / "large")
    create(path, 4096 * 4096 * 3, 1)
    assert os.stat(path).st_size > 4096 * 4096 * 3 * SLOTS
    assert os.stat(path).st_blocks * 512 < 1 << 20


def test_a_reader_cannot_write(path: str) -> None:
    reader = FrameRing(path)
    with pytest.raises(TypeError):
        reader.beat(1)


def test_a_source_writes_its_description_and_its_heartbeat(path: str) -> None:
    writer, reader = FrameRing(path, writes=True), FrameRing(path)
    assert (reader.description, reader.beaten_ns) == (b"", 0)
    writer.write_description(b"well")
    writer.beat(7)
    assert (reader.description, reader.beaten_ns) == (b"well", 7)
    writer.write_description(b"x" * PAGE)
    assert set(reader.description) == {ord("x")}


def test_compressed_pictures_lie_beside_and_only_if_they_fit(path: str) -> None:
    writer, reader = FrameRing(path, writes=True), FrameRing(path)
    assert reader.read_compressed() is None
    writer.request_compressed(99)
    assert reader.requested_until_ns == 99
    assert writer.put_compressed(Shot(4, 44, SIDE, SIDE, b"jpeg"))
    assert reader.read_compressed() == Shot(4, 44, SIDE, SIDE, b"jpeg")
    assert not writer.put_compressed(Shot(5, 55, SIDE, SIDE, bytes(COMPRESSED_ROOM + 1)))
    assert reader.newest_compressed == 4


def test_a_process_that_needs_no_pictures_does_not_map_them(tmp_path: Path) -> None:
    """A root locks all memory that it maps, and may lock only little."""
    path = str(tmp_path / "large")
    create(path, 4096 * 4096 * 3, 1)
    root, camera = FrameRing(path, writes=True, front=True), FrameRing(path, writes=True)
    assert put(camera, 1) == root.newest == 1
    assert camera.put_compressed(Shot(1, 11, SIDE, SIDE, b"jpeg"))
    assert root.read_compressed() == Shot(1, 11, SIDE, SIDE, b"jpeg")
    root.request_compressed(7)
    assert camera.requested_until_ns == 7
    assert root.mapped_bytes < 4 << 20


def test_saf_024_only_a_picture_allocates_shared_memory() -> None:
    """If shared memory is full, an access to memory that is not allocated ends the process (SIGBUS)."""
    with tempfile.TemporaryDirectory(dir=SHARED if SHARED.is_dir() else None) as folder:
        path = f"{folder}/ring"
        create(path, BYTES, 1)
        ring = FrameRing(path, writes=True)
        before = os.stat(path).st_blocks
        assert (ring.read(), ring.read_compressed()) == (None, None)
        assert (ring.newest, ring.newest_compressed, ring.captured_ns, ring.description) == (0, 0, 0, b"")
        ring.beat(1)
        ring.request_compressed(2)
        ring.write_description(b"x" * PAGE)
        assert os.stat(path).st_blocks == before
        put(ring, 1)
        assert os.stat(path).st_blocks > before
        ring.close()


def test_saf_024_pictures_without_room_are_refused_with_the_place(
    path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    ring = FrameRing(path, writes=True)
    monkeypatch.setattr(os, "posix_fallocate", full)
    monkeypatch.setattr(os, "pwrite", full)
    text = rf"no room for the camera's pictures in {tmp_path} \(No space left on device\)\. Free some space there"
    with pytest.raises(OSError, match=text):
        put(ring, 1)
    with pytest.raises(OSError, match=text):
        ring.put_compressed(Shot(1, 11, SIDE, SIDE, b"jpeg"))
    with pytest.raises(OSError, match=text):
        create(str(tmp_path / "another"), BYTES, 1)
    assert ring.newest == 0
    assert [file.name for file in tmp_path.iterdir()] == ["ring"]


def test_a_file_that_was_replaced_is_known_as_such(path: str) -> None:
    reader = FrameRing(path)
    assert reader.is_current
    create(path, BYTES, 1)
    assert not reader.is_current
    os.unlink(path)
    assert not reader.is_current


@pytest.mark.parametrize("content", [b"", b"x" * PAGE, bytes(3 * PAGE)])
def test_a_file_that_is_no_ring_is_refused(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "file"
    file.write_bytes(content)
    with pytest.raises(NoRing, match="is no ring of pictures"):
        FrameRing(str(file))


def test_a_link_is_not_followed(path: str, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(path)
    with pytest.raises(NoRing):
        FrameRing(str(tmp_path / "link"))

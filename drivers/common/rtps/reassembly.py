"""Assemble samples from fragments. Pure. The number of unfinished samples, their bytes and their age are
bounded."""

from __future__ import annotations

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .messages import Fragment

MAX_SAMPLES = 16
MAX_BYTES = 8 << 20
"""Of all samples in the making; no sample may be longer than this."""
PATIENCE_NS = 1_000_000_000
"""After its last fragment, a sample in the making is given up."""


class _Part:
    def __init__(self, fragment: Fragment) -> None:
        self.size = fragment.size
        self.payload = bytearray(fragment.total)
        self.have = bytearray(-(-fragment.total // fragment.size))
        self.t_ns = 0


class Reassembly:
    def __init__(self) -> None:
        self.dropped = 0
        self._parts: dict[tuple[bytes, int], _Part] = {}
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._parts)

    def add(self, fragment: Fragment, now_ns: int) -> bytearray | None:
        """Add a fragment. Return the whole sample once all its fragments have arrived, otherwise None. Raise
        ``MalformedFrame`` if its fragments contradict each other."""
        name = (fragment.writer, fragment.sequence)
        part = self._parts.get(name)
        if part is None:
            if fragment.total > MAX_BYTES:
                raise MalformedFrame(f"a sample of {fragment.total} bytes")
            self._make_room(fragment.total)
            part = self._parts[name] = _Part(fragment)
            self._bytes += fragment.total
        elif part.size != fragment.size or len(part.payload) != fragment.total:
            self._drop(name)
            raise MalformedFrame("fragments of one sample that do not fit together")
        part.t_ns = now_ns
        offset = fragment.first * fragment.size
        part.payload[offset : offset + len(fragment.payload)] = fragment.payload
        part.have[fragment.first : fragment.first + fragment.pieces] = b"\x01" * fragment.pieces
        if 0 in part.have:
            return None
        self._remove(name)
        return part.payload

    def tick(self, now_ns: int) -> None:
        for name in [name for name, part in self._parts.items() if now_ns - part.t_ns > PATIENCE_NS]:
            self._drop(name)

    def forget(self, prefix: bytes) -> None:
        """Drop all unfinished samples of one participant."""
        for name in [name for name in self._parts if name[0].startswith(prefix)]:
            self._drop(name)

    def _make_room(self, size: int) -> None:
        while len(self._parts) >= MAX_SAMPLES or self._bytes + size > MAX_BYTES:
            self._drop(next(iter(self._parts)))

    def _drop(self, name: tuple[bytes, int]) -> None:
        self.dropped += 1
        self._remove(name)

    def _remove(self, name: tuple[bytes, int]) -> None:
        self._bytes -= len(self._parts.pop(name).payload)

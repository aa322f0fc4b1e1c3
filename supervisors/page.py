"""The page of memory that root, wire and standby of one robot share, and what stands where on
it.

Whether something may be energised stands here because the standby can ask nobody: a wire that is
killed while it makes safe leaves a standby that acts; one that has made safe, a standby that ends.
"""

from __future__ import annotations

from strands_actors.kernel.health.heartbeat import Word, private_page

ROOT, WIRE, STANDBY = range(3)
"""Places of heartbeats."""
_OWED, _SILENT = 3, 4


class Owed:
    """What the standby must know of a wire that can no longer be asked."""

    def __init__(self, words: memoryview | None = None) -> None:
        """None: nobody shares it."""
        page = private_page() if words is None else words
        self._owed = Word(page, _OWED)
        self._silent = Word(page, _SILENT)

    @property
    def safe_state(self) -> bool:
        """Return whether something may be energised: from before arming until every motor has
        confirmed the safe state of a stop. Written by the wire, and by the root once that has made
        safe in its place."""
        return self._owed.get() != 0

    @safe_state.setter
    def safe_state(self, owed: bool) -> None:
        self._owed.set(int(owed))

    @property
    def silent_until_ns(self) -> int:
        """The wire may not beat until then: an SDK keeps the interpreter's lock."""
        return self._silent.get()

    @silent_until_ns.setter
    def silent_until_ns(self, until_ns: int) -> None:
        self._silent.set(until_ns)

"""Bound what one turn takes in of what a peer sends (SAF-025).

A loop that reads until nothing is left has no end while the peer sends faster than we read. So a
turn takes a bounded number of pieces and bytes, keeps its place, and returns: the process sends its
heartbeats, and goes on in its next turn. A peer that has more to send at the end of many turns in a
row cannot be followed: what is read is older than it looks. Then the connection counts as lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from strands_actors.contract.wire import WireDown

PIECES = 64
"""Datagrams, packets or reads of one turn. At 100 turns a second a robot may send 6,400."""
SIZE = 16 * 1024
"""Bytes of one turn. The smallest messages of our protocols have 8 bytes: 2,000 take some 5 ms."""
BUSY_TURNS = 25
"""Turns in a row that end with more waiting. An honest backlog, of a link that was held up, is read
by then."""


class ReceiveBudget:
    """What one reader may take in one turn, and how long the peer has been ahead of it."""

    def __init__(self, name: str, pieces: int = PIECES, size: int = SIZE, busy_turns: int = BUSY_TURNS) -> None:
        """Make the budget of one connection.

        Args:
            name: The peer, for messages.
            pieces: Reads of one turn.
            size: Bytes of one turn. The last read may exceed it.
            busy_turns: Turns in a row that may end with more waiting.
        """
        self._name = name
        self._pieces = pieces
        self._size = size
        self._busy_turns = busy_turns
        self._busy = 0

    def turn(self, read_waiting: Callable[[], bytes | None]) -> Iterator[bytes]:
        """Yield what has arrived, as much as one turn may take.

        Raises:
            WireDown: The peer was ahead in too many turns. All that was read has been yielded.
        """
        left = self._size
        for _ in range(self._pieces):
            data = read_waiting()
            if data is None:
                self.caught_up()
                return
            yield data
            left -= len(data)
            if left <= 0:
                break
        self.fell_behind()

    def caught_up(self) -> None:
        """Note that nothing was left at the end of a turn."""
        self._busy = 0

    def fell_behind(self) -> None:
        """Note that more was waiting at the end of a turn. Raise ``WireDown`` as ``turn``."""
        self._busy += 1
        if self._busy > self._busy_turns:
            raise WireDown(
                f"{self._name}: the peer sends more than can be read ({self._busy} turns in a row ended with more "
                "waiting). Check what is connected there, then reconnect"
            )

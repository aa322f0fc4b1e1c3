"""Bound the data that one turn of a loop reads from a peer (SAF-025).

A loop that reads until no data is left never ends if the peer sends faster than this process reads. So one turn
reads a bounded number of pieces and bytes, and returns. The process then sends its heartbeats, and continues to
read in its next turn. If data is left over at the end of many turns in a row, the data that is read is older than
it looks. The connection then counts as lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from strands_actors.contract.wire import WireDown

PIECES = 64
"""Most datagrams, packets or reads of one turn. At 100 turns a second a robot may send 6,400."""
SIZE = 16 * 1024
"""Most bytes of one turn. The smallest messages of our protocols have 8 bytes: 2,000 take some 5 ms."""
BUSY_TURNS = 25
"""Most turns in a row that may end with more data waiting. By then a normal backlog, after a link was
held up, is read."""


class ReceiveBudget:
    """The most data that one connection may read per turn (one pass of the loop that receives). It also counts the
    turns that left data unread."""

    def __init__(self, name: str, pieces: int = PIECES, size: int = SIZE, busy_turns: int = BUSY_TURNS) -> None:
        """Set the limits of one connection.

        Args:
            name: The name of the peer, for messages.
            pieces: Most reads in one turn.
            size: Most bytes in one turn. The last read may exceed it.
            busy_turns: Most turns in a row that may leave data unread.
        """
        self._name = name
        self._pieces = pieces
        self._size = size
        self._busy_turns = busy_turns
        self._busy = 0

    def turn(self, read_waiting: Callable[[], bytes | None]) -> Iterator[bytes]:
        """Yield the data that has arrived, up to the limits of one turn (one pass of the loop that receives).

        Args:
            read_waiting: Return the next piece of data, or None if there is no data. Never waits.

        Raises:
            WireDown: Too many turns in a row left data unread. All data of this turn was yielded before.
        """
        remaining = self._size
        for _ in range(self._pieces):
            data = read_waiting()
            if data is None:
                self.caught_up()
                return
            yield data
            remaining -= len(data)
            if remaining <= 0:
                break
        self.fell_behind()

    def caught_up(self) -> None:
        """Note that this turn of the receiving loop left no data unread."""
        self._busy = 0

    def fell_behind(self) -> None:
        """Note that this turn of the receiving loop left data unread. Raise ``WireDown`` after too many such turns
        in a row."""
        self._busy += 1
        if self._busy > self._busy_turns:
            raise WireDown(
                f"{self._name}: the peer sends more than this process can read ({self._busy} turns in a row "
                "left data unread). Check what is connected there, then reconnect"
            )

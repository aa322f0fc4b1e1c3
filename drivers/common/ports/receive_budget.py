"""Bound what one turn reads from a peer (SAF-025).

A loop that reads until nothing is left never ends while the peer sends faster than this process reads.
So a turn takes a bounded number of pieces and bytes, keeps its place, and returns. The process then sends
its heartbeats, and continues in its next turn. If more data waits at the end of many turns in a row, the
data that is read is older than it looks. The connection then counts as lost.
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
    """The budget of one reader per turn, and a count of the turns in which the peer was ahead."""

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
        """Yield the data that has arrived, as much as one turn may take.

        Args:
            read_waiting: Return the next piece, or None if there is no piece. Never waits.

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
        """Note that more was waiting at the end of a turn. Raise ``WireDown`` as ``turn`` does."""
        self._busy += 1
        if self._busy > self._busy_turns:
            raise WireDown(
                f"{self._name}: the peer sends more than can be read ({self._busy} turns in a row ended with more "
                "waiting). Check what is connected there, then reconnect"
            )

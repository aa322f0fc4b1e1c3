"""Spoil the answers of a peer, on a connection or in datagrams, as a broken or hostile peer does."""

from __future__ import annotations

import random
from collections import deque

UNASKED = 0.5
"""Share of the answers that are preceded by an old answer."""
FLOOD = 40
"""Copies of each answer that a flood sends."""
KEPT = 8
"""Number of old answers that the peer keeps."""
MOST_HEARD = 3
"""Most pieces that the peer reads from a new connection before it resets the connection."""


class HostilePeer:
    """A peer that may be broken or hostile. Each stream of answers has its own ``Stream``.

    Attributes:
        kind: One of ``kinds.PEER``; empty if the peer works.
    """

    def __init__(self, rng: random.Random) -> None:
        self.kind = ""
        self._rng = rng

    def stream(self) -> Stream:
        return Stream(self, self._rng)

    def heard_before_reset(self) -> int | None:
        """Return how many pieces it reads from a new connection before it resets the connection;
        None if it keeps the connection."""
        return self._rng.randrange(MOST_HEARD + 1) if self.kind == "refuse" else None


class Stream:
    """Answers of one connection, in order."""

    def __init__(self, peer: HostilePeer, rng: random.Random) -> None:
        self._peer = peer
        self._rng = rng
        self._old: deque[bytes] = deque(maxlen=KEPT)
        self._cut = False

    def spoil(self, answer: bytes) -> list[bytes]:
        """Return the pieces that are sent instead of an answer."""
        rng, old, kind = self._rng, self._old, self._peer.kind
        before = old[-1] if old else b""
        old.append(answer)
        if kind != "half frame":
            self._cut = False
        match kind:
            case "babble":
                return [rng.randbytes(len(answer))]
            case "half frame":
                cut, self._cut = self._cut, True
                return [] if cut else [answer[: rng.randrange(len(answer))]]
            case "old answers":
                return [before] if before else []
            case "unasked" if rng.random() < UNASKED:
                return [rng.choice(old), answer]
            case "flood":
                return [answer] * FLOOD
        return [answer]

"""What a broken or hostile peer makes of what it sends, on a connection or in datagrams."""

from __future__ import annotations

import random
from collections import deque

UNASKED = 0.5
"""Share of answers that an old one comes with."""
FLOOD = 40
"""Copies of each answer."""
KEPT = 8
"""Old answers that it still knows."""
MOST_HEARD = 3
"""Pieces that it takes on a new connection at most before it resets it."""


class HostilePeer:
    """``kind``: one of ``kinds.PEER``; empty: it is sound. Each stream of answers has a ``Stream``
    of its own."""

    def __init__(self, rng: random.Random) -> None:
        self.kind = ""
        self._rng = rng

    def stream(self) -> Stream:
        return Stream(self, self._rng)

    def heard_before_reset(self) -> int | None:
        """Return how many pieces it takes on a new connection before it resets it. None: it keeps
        the connection."""
        return self._rng.randrange(MOST_HEARD + 1) if self.kind == "refuse" else None


class Stream:
    """Answers of one connection, in order."""

    def __init__(self, peer: HostilePeer, rng: random.Random) -> None:
        self._peer = peer
        self._rng = rng
        self._old: deque[bytes] = deque(maxlen=KEPT)
        self._cut = False

    def spoil(self, answer: bytes) -> list[bytes]:
        """Return what leaves in place of an answer."""
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

"""What a wire keeps up beside its calls."""

from __future__ import annotations

import trio

from strands_actors.contract.wire import ProcessSpent, Wire, WireDown


class Serving:
    """``Wire.serve`` of one open wire: runs it, and says when it is ready and how it has ended."""

    def __init__(self) -> None:
        self.scope = trio.CancelScope()
        self.ready = trio.Event()
        self.failure: WireDown | ProcessSpent | None = None

    async def run(self, wire: Wire) -> None:
        """Return when ``scope`` is cancelled or the wire can be served no more."""
        with self.scope:
            try:
                async with trio.open_nursery() as nursery:
                    await nursery.start(wire.serve)
                    self.ready.set()
            except* (WireDown, ProcessSpent) as failures:
                failure: BaseException = failures
                while isinstance(failure, BaseExceptionGroup):
                    failure = failure.exceptions[0]
                assert isinstance(failure, WireDown | ProcessSpent)
                self.failure = failure
        self.ready.set()

    def check(self) -> None:
        """Raise what ended it."""
        if self.failure is not None:
            raise self.failure

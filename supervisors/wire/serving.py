"""Run ``Wire.serve`` of an open wire in the background."""

from __future__ import annotations

import trio

from strands_actors.contract.wire import ProcessSpent, Wire, WireDown


class Serving:
    """One run of ``Wire.serve``: ``ready`` is set when it serves or has failed, ``failure`` when it has
    failed."""

    def __init__(self) -> None:
        self.scope = trio.CancelScope()
        self.ready = trio.Event()
        self.failure: WireDown | ProcessSpent | None = None

    async def run(self, wire: Wire) -> None:
        """Serve the wire until ``scope`` is cancelled or it fails."""
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
        """Raise the failure, if there is one."""
        if self.failure is not None:
            raise self.failure

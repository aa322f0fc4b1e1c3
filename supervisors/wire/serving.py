"""Run the background tasks of a connected wire (``Wire.serve``)."""

from __future__ import annotations

import trio

from strands_actors.contract.wire import ProcessSpent, Wire, WireDown


class Serving:
    """One run of ``Wire.serve``, the background tasks of a connection to the robot. ``ready`` is set when the
    tasks run or have failed. ``failure`` is the exception if they have failed."""

    def __init__(self) -> None:
        self.scope = trio.CancelScope()
        self.ready = trio.Event()
        self.failure: WireDown | ProcessSpent | None = None

    async def run(self, wire: Wire) -> None:
        """Run ``Wire.serve`` until ``scope`` is cancelled or it fails."""
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
        """Raise the exception with which ``Wire.serve`` has failed, if any."""
        if self.failure is not None:
            raise self.failure

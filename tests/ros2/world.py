"""Run ``strands-actors ros2`` within a test, in a thread with its own loop."""

from __future__ import annotations

import threading
from types import TracebackType

import trio

from strands_actors.surfaces.mesh.client import open_mesh
from strands_actors.surfaces.mesh.config import MeshConfig
from strands_actors.surfaces.ros2.bridge import Bridge, Options, open_bridge

PATIENCE_S = 30.0


class RunningBridge:
    """A bridge that runs as long as the ``with`` block."""

    def __init__(self, options: Options) -> None:
        self.lines: list[str] = []
        self._options = options
        self._opened = threading.Event()
        self._thread = threading.Thread(target=trio.run, args=(self._main,), daemon=True)

    def __enter__(self) -> RunningBridge:
        self._thread.start()
        assert self._opened.wait(PATIENCE_S), self.lines
        return self

    def __exit__(
        self, error_type: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._token.run_sync_soon(self._scope.cancel)
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    async def _main(self) -> None:
        self._token = trio.lowlevel.current_trio_token()
        async with open_mesh(MeshConfig()) as mesh, open_bridge(mesh, self._options, self.lines.append) as bridge:
            self.bridge: Bridge = bridge
            with trio.CancelScope() as self._scope:
                self._opened.set()
                await trio.sleep_forever()

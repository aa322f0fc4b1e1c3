"""Run a WebSocket server in a thread, as policy servers of the tests are."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

from websockets.sync.server import ServerConnection, serve


@contextlib.contextmanager
def served(handle: Callable[[ServerConnection], None]) -> Iterator[int]:
    """Serve connections while the block runs, and yield the port."""
    with serve(handle, "127.0.0.1", 0) as listening:
        thread = threading.Thread(target=listening.serve_forever)
        thread.start()
        try:
            yield listening.socket.getsockname()[1]
        finally:
            listening.shutdown()
            thread.join()

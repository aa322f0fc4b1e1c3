"""``view LENGTH ROBOT PORT LOG``: measure what a live view costs the setpoints of the robot that it shows.

LENGTH is ``short`` or ``long``. ROBOT is the name of the robot, PORT the port of the simulated robot, and LOG the
file of the frames that it has read. The delay of setpoints (``setpoint``) is measured in turns: without a view, and
with a view to which a client of Foxglove is connected. The client subscribes to everything.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from benchmarks.stage import COMMAND

from .setpoint import ours
from .wire import Log, delays_us, percentile, processor_s

TURNS = {"short": (1, 60), "long": (4, 300)}
"""Number of turns, and of setpoints in each."""
PATIENCE_S = 30.0
SETTLE_S = 1.0


class Client:
    """A client that subscribes to all channels, and counts what comes."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.frames = 0
        self.first = threading.Event()

    def run(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            for data in self._connection:
                if isinstance(data, bytes):
                    self.frames += 1
                    self.first.set()
                    continue
                message = json.loads(data)
                if message["op"] == "advertise":
                    wanted = [{"id": each["id"], "channelId": each["id"]} for each in message["channels"]]
                    self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


@contextlib.contextmanager
def viewed(robot: str) -> Iterator[tuple[int, float]]:
    """Run a view and its client. Yield the process id of the view, and the seconds until the first frame."""
    arguments = [sys.executable, "-c", COMMAND, "view", robot, "--foxglove", "--port", "0", "--json"]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = json.loads(process.stdout.readline())["foxglove"]
            began_s = time.monotonic()
            with connect(url, subprotocols=[Subprotocol("foxglove.sdk.v1")], max_size=None) as connection:
                client = Client(connection)
                reader = threading.Thread(target=client.run)
                reader.start()
                if not client.first.wait(PATIENCE_S):
                    raise SystemExit(f"no frame of the view within {PATIENCE_S:g} s")
                yield process.pid, time.monotonic() - began_s
            reader.join()
        finally:
            process.kill()


def main(length: str, robot: str, port: str, log_path: str) -> None:
    turns, count = TURNS[length]
    log = Log(log_path)
    send, close = ours(robot, port)
    alone_us: list[float] = []
    viewed_us: list[float] = []
    firsts_s: list[float] = []
    used_s = watched_s = 0.0
    for _ in range(turns):
        time.sleep(SETTLE_S)
        alone_us += delays_us(send, log, count)
        with viewed(robot) as (pid, first_s):
            firsts_s.append(first_s)
            time.sleep(SETTLE_S)
            before_s, began_s = processor_s(pid), time.monotonic()
            viewed_us += delays_us(send, log, count)
            used_s += processor_s(pid) - before_s
            watched_s += time.monotonic() - began_s
    close()
    alone, beside = (percentile(delays, 0.99) for delays in (alone_us, viewed_us))
    figures = {
        "setpoint_p50_alone_us": percentile(alone_us, 0.5),
        "setpoint_p50_viewed_us": percentile(viewed_us, 0.5),
        "setpoint_p99_alone_us": alone,
        "setpoint_p99_viewed_us": beside,
        "p99_ratio": beside / alone,
        "first_frame_s": max(firsts_s),
        "view_pct": 100 * used_s / watched_s,
    }
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

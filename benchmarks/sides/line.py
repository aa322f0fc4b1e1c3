"""``line ROBOT FILE``: simulate a servo bus that is never late. It writes the path of its port to FILE.

It has the servos and the physics of the simulated robot, but another main loop. This loop never sleeps, so that
the wake-up of a core does not delay a byte. A pseudo-terminal also delays bytes (a kernel thread carries them,
40 us here; a UART has no such delay). This delay is measured first, and subtracted in each direction. The
process runs until it is killed.
"""

from __future__ import annotations

import gc
import importlib
import os
import sys
import time
from collections import deque
from pathlib import Path

from strands_actors.drivers.common.twin import PtyLine

NS_PER_BYTE = 10_000
"""8N1 at 1 Mbaud."""

BUSES = {"so101": "feetech:FeetechBus", "koch": "dynamixel:DynamixelBus"}
RETURN_DELAY = {"so101": 7, "koch": 9}
"""Register of the return delay. It is set to 0 in every servo, as users do. The factory setting is half a
millisecond."""


HOPS = 200


def hop_ns(master: int, slave: int) -> int:
    """Return the median time from a write at one end of a pseudo-terminal until it can be read at the other."""
    took = []
    for _ in range(HOPS):
        time.sleep(0.0005)
        began_ns = time.monotonic_ns()
        os.write(slave, b"x")
        while True:
            try:
                os.read(master, 1)
                break
            except BlockingIOError:
                pass
        took.append(time.monotonic_ns() - began_ns)
    return sorted(took)[HOPS // 2]


def main(robot: str, path: str) -> None:
    module, _, name = BUSES[robot].partition(":")
    bus = getattr(importlib.import_module(f"strands_actors.drivers.{module}.twin"), name).for_robot(robot)
    for servo in bus.servos:
        servo.table[RETURN_DELAY[robot]] = 0
    line = PtyLine()
    line.plug()
    fd = line._master
    hop = hop_ns(fd, line._slave)
    Path(f"{path}.new").write_text(line.address)
    Path(f"{path}.new").rename(path)
    gc.freeze()
    gc.disable()
    waiting: deque[tuple[int, bytes]] = deque()
    free_ns = 0
    rate = 1_000_000
    while True:
        try:
            data = os.read(fd, 4096)
        except BlockingIOError:
            data = b""
        if data:
            received_ns = time.monotonic_ns() - hop
            rate = line.bits_per_s() or rate
            for exchange in bus.receive(data, rate):
                free_ns = max(received_ns, free_ns) + len(exchange.request) * NS_PER_BYTE
                answer = b"".join(reply.data for reply in exchange.replies)
                delay_s = sum(reply.delay_s for reply in exchange.replies)
                if answer:
                    free_ns += len(answer) * NS_PER_BYTE + round(delay_s * 1e9)
                    waiting.append((free_ns, answer))
        while waiting and waiting[0][0] - hop <= time.monotonic_ns():
            os.write(fd, waiting.popleft()[1])


if __name__ == "__main__":
    main(*sys.argv[1:])

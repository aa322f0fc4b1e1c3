"""``legs_bare LENGTH``: measure the processor time of a trio loop that wakes up 500 times per second and does
nothing else, as a share of one core. LENGTH is ``short`` or ``long`` (2 or 15 s).
"""

from __future__ import annotations

import json
import sys
import time

import trio

PERIOD_S = 0.002
SECONDS = {"short": 2.0, "long": 15.0}


def share_of_ticks(period_s: float, seconds: float) -> float:
    """Return the processor time of a trio loop that only wakes up once per period, as a share of a core."""

    async def tick() -> None:
        began_s = trio.current_time()
        for number in range(1, round(seconds / period_s)):
            await trio.sleep_until(began_s + number * period_s)

    began_s, used_s = time.monotonic(), time.process_time()
    trio.run(tick)
    return (time.process_time() - used_s) / (time.monotonic() - began_s)


def main(length: str) -> None:
    print(json.dumps({"process_pct": 100 * share_of_ticks(PERIOD_S, SECONDS[length])}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

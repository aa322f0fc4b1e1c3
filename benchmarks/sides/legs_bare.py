"""``legs_bare LENGTH``: what a tick of trio's at 500 Hz takes of a core on this machine, with
nothing in it."""

from __future__ import annotations

import json
import sys
import time

import trio

PERIOD_S = 0.002
SECONDS = {"short": 2.0, "long": 15.0}


def share_of_ticks(period_s: float, seconds: float) -> float:
    """Of a core, that a loop takes which only wakes so often."""

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

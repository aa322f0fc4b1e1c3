"""``legs_bare LENGTH``: what a tick of trio's at 500 Hz takes of a core on this machine, with nothing in it."""

from __future__ import annotations

import json
import sys
import time

import trio

PERIOD_S = 0.002
SECONDS = {"short": 2.0, "long": 15.0}


async def tick(seconds: float) -> None:
    began_s = trio.current_time()
    for number in range(1, round(seconds / PERIOD_S)):
        await trio.sleep_until(began_s + number * PERIOD_S)


def main(length: str) -> None:
    began_s, used_s = time.monotonic(), time.process_time()
    trio.run(tick, SECONDS[length])
    share = (time.process_time() - used_s) / (time.monotonic() - began_s)
    print(json.dumps({"process_pct": 100 * share}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

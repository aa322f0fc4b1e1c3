"""Bring a Crazyflie down by its radio or USB: ``python -m ...stop_process PORT SAFE_STATE``. Prints
what became of it as JSON. The root starts it when the wire process is gone, and with that its hold
on the USB device."""

from __future__ import annotations

import sys

import msgspec
import trio

from strands_actors.contract.driver import ProcessSpent, WireDown
from strands_actors.kernel.clock import MonotonicClock

from .config import parse_port
from .session import Session
from .stopping import Outcome, bring_down
from .usb_links import open_usb_link


async def stop(port: str, safe_state: str) -> Outcome:
    try:
        link = await open_usb_link(parse_port(port))
        try:
            return await bring_down(Session(link, MonotonicClock()), safe_state)
        finally:
            link.close()
    except (WireDown, ProcessSpent) as failure:
        return Outcome(False, False, str(failure))


if __name__ == "__main__":
    print(msgspec.json.encode(trio.run(stop, sys.argv[1], sys.argv[2])).decode(), flush=True)

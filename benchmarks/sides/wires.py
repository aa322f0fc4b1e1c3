"""``wires WHO LENGTH ROBOT HZ PORT LOG [PID LATE_PORT FLAG]``: move a robot's twin by WHO, a module of
``wire_clients``.

Measured are the time from a setpoint to its first frame that the twin reads, the time from a stop to the first
safe frame, and the processor time of the client during a stream at HZ. For a robot behind a service, there are
two more stops:

* of a frozen twin (PID), measured from when it continues;
* at LATE_PORT, with answers that are late while the file FLAG exists (``late_answers``).

Each command that is stopped runs in a separate thread. The stop comes 50 ms after the command was begun, even
if the call has not returned.

``wires quicker LENGTH ROBOT USUAL_HZ HZ PORT``: the processor time of our side at another rate.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import re
import signal
import statistics
import struct
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .wire import Frame, Log, percentile, processor_s, reversed_until
from .wire_clients.hand import Hand

SETPOINTS = {"short": 5, "long": 30}
STOPS = {"short": 1, "long": 5}
TROUBLED = {"short": 1, "long": 3}
"""Number of stops of a late twin, and of a frozen one."""
STREAM_S = {"short": 0.5, "long": 3.0}
MOVES_S = 0.05
FROZEN_S = 1.0
SAFE_S = 15.0
"""Timeout for a safe frame on the wire, in seconds."""
RETURN_S = 30.0

Said = Callable[[Frame], object]


def whole(frame: Frame) -> object:
    return frame.data if frame.kind == "setpoint" else None


def xarm(frame: Frame) -> object:
    """Return the request without its number."""
    return frame.data[4:] if frame.kind == "setpoint" else None


def kinova(frame: Frame) -> object:
    """Return True if the first joint is fast. Its speed changes in every frame on the way to the target, so
    the value itself is no sign of a new target."""
    found = re.search(b"\x0a\x07\x08\x00\x15(.{4})", bytes.fromhex(frame.data), re.DOTALL)
    if frame.kind != "setpoint" or found is None:
        return None
    return abs(struct.unpack("<f", found[1])[0]) > QUICK_DEG_S


def kuka(frame: Frame) -> object:
    """Return the target of the first joint, rounded to 0.1 mrad. There is a frame in every cycle, so only a
    changed target counts."""
    found = re.search(b"\x0a\x3f\x09(.{8})", bytes.fromhex(frame.data), re.DOTALL)
    if frame.kind != "setpoint" or found is None:
        return None
    return round(struct.unpack("<d", found[1])[0], 4)


def franka(frame: Frame) -> object:
    """Return the request to move. The cycle begins after the controller's answer to it."""
    return frame.data if frame.kind == "enable" and frame.data.startswith("01000000") else None


QUICK_DEG_S = 5.0
END_OF_MOVE = b"POST /api/move/stop".hex()
"""The request that ends one move of a Reachy. REST has no request that stops everything, so the twin marks no
frame as safe."""
STANDS = re.compile("7c(0a|05)0{24}")
"""A hover at zero speed. A Crazyflie's twin marks only our hover as safe."""
SAID: dict[str, Said] = {"xarm7": xarm, "kinova_gen3": kinova, "kuka_iiwa": kuka, "panda": franka, "fr3": franka}
"""Functions that return the target in a frame, or None for a frame without one. ``whole`` is the default."""


def is_safe(frame: Frame) -> bool:
    return frame.kind == "safe" or frame.data.startswith(END_OF_MOVE) or bool(STANDS.match(frame.data))


def tells(frame: Frame) -> bool:
    """Return True if a frame moves the robot or stops it."""
    return frame.kind == "setpoint" or is_safe(frame)


def first_safe(log: Log, since_ns: int) -> Frame | None:
    """Wait for the first safe frame since a time, and return it; None after ``SAFE_S``."""
    until_s = time.monotonic() + SAFE_S
    while True:
        for frame in reversed_until(log.read(), since_ns):
            if is_safe(frame):
                return frame
        if time.monotonic() > until_s:
            return None
        time.sleep(0.01)


def setpoints_us(hand: Hand, log: Log, said: Said, count: int, pause_s: float) -> list[float]:
    """Return the delays of setpoints, from before each call to the first frame with a new target.

    Pauses vary, so that they do not coincide with a period of a client.
    """
    began = []
    for number in range(count):
        began.append(hand.setpoint(number))
        time.sleep(pause_s * (1 + (number * 7 % 10) / 20))
    time.sleep(0.2)
    frames = [(frame.t_ns, what) for frame in log.read() if (what := said(frame)) is not None]
    found, at = [], 0
    for t_ns in began:
        while at < len(frames) and frames[at][0] < t_ns:
            at += 1
        before = frames[at - 1][1] if at else None
        new = next((frame_ns for frame_ns, what in frames[at:] if what != before), None)
        if new is not None:
            found.append((new - t_ns) / 1e3)
    if len(found) < count * 0.9:
        raise RuntimeError(f"{count} setpoints sent, {len(found)} seen on the wire")
    return found


def computed_s(pids: list[int]) -> float:
    return sum(map(processor_s, pids))


def shares(hand: Hand, hz: float, seconds: float) -> dict[str, float]:
    wire, others = hand.pids()
    began_s, wire_s, others_s = time.monotonic(), computed_s(wire), computed_s(others)
    hand.stream(hz, seconds)
    took_s = time.monotonic() - began_s
    wire_s, others_s = computed_s(wire) - wire_s, computed_s(others) - others_s
    found = {"all_pct": 100 * (wire_s + others_s) / took_s}
    return {"wire_pct": 100 * wire_s / took_s, **found} if others else found


def moving(hand: Hand, number: int) -> threading.Thread:
    """Start a command in a thread, and return after 50 ms and a varying time. The robot moves then."""
    thread = threading.Thread(target=_quietly(lambda: hand.move(number)), daemon=True)
    thread.start()
    time.sleep(MOVES_S + 0.002 * (number * 7 % 10))
    return thread


def _quietly(call: Callable[[], object]) -> Callable[[], None]:
    """Return a call that ignores errors, since a stop or a frozen robot may end it."""

    def run() -> None:
        with contextlib.suppress(Exception):
            call()

    return run


def stop_once(hand: Hand, log: Log, number: int) -> float | None:
    """Return the milliseconds from a stop to its first frame on the wire; None if the robot was already safe."""
    thread = moving(hand, number)
    began_ns = time.monotonic_ns()
    hand.stop()
    safe = first_safe(log, began_ns)
    thread.join(RETURN_S)
    before = [is_safe(frame) for frame in log.frames if frame.t_ns < began_ns and tells(frame)]
    if before[-1:] == [True]:
        return None
    if safe is None:
        raise RuntimeError("no safe frame on the wire")
    return (safe.t_ns - began_ns) / 1e6


def stops_ms(hand: Hand, log: Log, count: int, before: Callable[[], object], after: Callable[[], object]) -> Any:
    found: list[float] = []
    for number in range(2 * count):
        before()
        took = stop_once(hand, log, number)
        after()
        hand.again()
        found += [] if took is None else [took]
        if len(found) == count:
            return found
    raise RuntimeError("made safe before it was stopped, again and again")


def frozen_once(hand: Hand, log: Log, pid: int, number: int) -> tuple[float, float]:
    """Stop a frozen twin. Return the milliseconds from its continuation to the first safe frame, and those that
    the call took."""
    thread = moving(hand, number)
    took: list[float] = []

    def stop() -> None:
        began_s = time.monotonic()
        _quietly(hand.stop)()
        took.append(1e3 * (time.monotonic() - began_s))

    stopping = threading.Thread(target=stop, daemon=True)
    os.kill(pid, signal.SIGSTOP)
    try:
        time.sleep(0.02)
        stopping.start()
        time.sleep(FROZEN_S)
    finally:
        again_ns = time.monotonic_ns()
        os.kill(pid, signal.SIGCONT)
    safe = first_safe(log, again_ns)
    stopping.join(RETURN_S)
    thread.join(RETURN_S)
    if safe is None:
        raise RuntimeError("no safe frame on the wire of a twin that went on")
    return (safe.t_ns - again_ns) / 1e6, took[0] if took else 1e3 * RETURN_S


def spread(name: str, found: list[float], unit: str = "ms") -> dict[str, float]:
    return {f"{name}_{unit}": statistics.median(found), f"{name}_worst_{unit}": max(found)}


def main(who: str, length: str, robot: str, hz: str, port: str, log_path: str, *service: str) -> None:
    client = importlib.import_module(f"{__package__}.wire_clients.{who}").Client
    hand: Hand = client(robot, port)
    log = Log(log_path)
    pause_s = max(hand.pause_s, 1 / float(hz))
    for number in range(3):  # warm-up
        hand.setpoint(number)
        time.sleep(pause_s)
    delays = setpoints_us(hand, log, SAID.get(robot, whole), SETPOINTS[length], pause_s)
    figures = {"setpoint_p50_us": percentile(delays, 0.5), "setpoint_p95_us": percentile(delays, 0.95)}
    figures |= shares(hand, float(hz), STREAM_S[length])
    figures |= spread("stop", stops_ms(hand, log, STOPS[length], lambda: None, lambda: None))
    if service:
        pid, late_port, flag = service
        found = []
        for number in range(TROUBLED[length]):
            found.append(frozen_once(hand, log, int(pid), number))
            hand.again()
        figures |= spread("frozen_stop", [each[0] for each in found])
        figures["frozen_call_ms"] = statistics.median(each[1] for each in found)
        hand.close()
        hand = client(robot, late_port)
        late = Path(flag)
        hand.setpoint(0)
        figures |= spread("late_stop", stops_ms(hand, log, TROUBLED[length], late.touch, late.unlink))
    hand.close()
    print(json.dumps(figures), flush=True)
    os._exit(0)  # a vendor's threads would keep the process alive


def quicker(length: str, robot: str, usual_hz: str, hz: str, port: str) -> None:
    """Measure the processor time of our side at another control rate."""
    ours = importlib.import_module(f"{__package__}.wire_clients.ours")
    hand: Hand = ours.Client(robot, port, scale=(float(usual_hz) / float(hz)) ** 2, control_frequency=float(hz))
    hand.setpoint(0)
    found = shares(hand, float(hz), STREAM_S[length])
    hand.close()
    print(json.dumps({f"at_{float(hz):g}_hz_wire_pct": found["wire_pct"]}), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "quicker":
        quicker(*sys.argv[2:])
    else:
        main(*sys.argv[1:])

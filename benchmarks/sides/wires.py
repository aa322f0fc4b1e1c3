"""``wires CLIENT LENGTH ROBOT HZ PORT LOG [PID LATE_PORT FLAG]``: move a simulated robot with the client CLIENT, a
module of ``wire_clients``.

LENGTH is ``short`` or ``long``, HZ the control rate, PORT the port of the simulated robot, and LOG the file of the
frames that it has read. Three things are measured: the time from a setpoint to its first frame that the robot
reads, the time from a stop to the first stop command that the robot reads, and the client's processor time while
it sends setpoints at HZ. If the robot is behind a service (a server process), two more stops are measured:

* The robot (process PID) is frozen. The time is measured from when it continues.
* At LATE_PORT, the service's answers are late while the file FLAG exists (``late_answers``).

The command that is stopped runs in a separate thread. The stop comes 50 ms after the command has begun, even if
the call that sends the command has not returned.

``wires quicker LENGTH ROBOT USUAL_HZ HZ PORT``: measure the processor time of this package at the control rate HZ
instead of USUAL_HZ.
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

from .wire import Frame, Log, frames_since, percentile, processor_s
from .wire_clients.hand import BaseClient

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

TargetReader = Callable[[Frame], object]


def whole(frame: Frame) -> object:
    return frame.data if frame.kind == "setpoint" else None


def xarm(frame: Frame) -> object:
    """Return a setpoint without its sequence number; None for another frame."""
    return frame.data[4:] if frame.kind == "setpoint" else None


def kinova(frame: Frame) -> object:
    """Return True if a frame commands the first joint to be fast; None if the frame is not a setpoint.

    The frame contains the joint's speed, which changes in every frame on the way to the target. So a changed value
    does not show a new target.
    """
    match = re.search(b"\x0a\x07\x08\x00\x15(.{4})", bytes.fromhex(frame.data), re.DOTALL)
    if frame.kind != "setpoint" or match is None:
        return None
    return abs(struct.unpack("<f", match[1])[0]) > QUICK_DEG_S


def kuka(frame: Frame) -> object:
    """Return the target of the first joint, rounded to 0.1 mrad; None if the frame is not a setpoint.

    There is a frame in every cycle, so only a changed target shows a new setpoint.
    """
    match = re.search(b"\x0a\x3f\x09(.{8})", bytes.fromhex(frame.data), re.DOTALL)
    if frame.kind != "setpoint" or match is None:
        return None
    return round(struct.unpack("<d", match[1])[0], 4)


def franka(frame: Frame) -> object:
    """Return the frame if it is the request to move, and None if it is another frame. The 1 kHz cycle begins only
    after the controller's answer.
    """
    return frame.data if frame.kind == "enable" and frame.data.startswith("01000000") else None


QUICK_DEG_S = 5.0
END_OF_MOVE = b"POST /api/move/stop".hex()
"""The request that ends one move of a Reachy. REST has no request that stops everything, so the twin marks no
frame as safe."""
STANDS = re.compile("7c(0a|05)0{24}")
"""A hover at zero speed. A Crazyflie's twin marks only our hover as safe."""
TARGET_READERS: dict[str, TargetReader] = {
    "xarm7": xarm,
    "kinova_gen3": kinova,
    "kuka_iiwa": kuka,
    "panda": franka,
    "fr3": franka,
}
"""Functions that return the target in a frame, or None for a frame without one. ``whole`` is the default."""


def is_safe(frame: Frame) -> bool:
    return frame.kind == "safe" or frame.data.startswith(END_OF_MOVE) or bool(STANDS.match(frame.data))


def is_command(frame: Frame) -> bool:
    """Return True if a frame commands a motion or a stop."""
    return frame.kind == "setpoint" or is_safe(frame)


def first_safe(log: Log, since_ns: int) -> Frame | None:
    """Return the first stop command that the robot receives since ``since_ns``; None if there is none for
    ``SAFE_S``.
    """
    until_s = time.monotonic() + SAFE_S
    while True:
        for frame in frames_since(log.read(), since_ns):
            if is_safe(frame):
                return frame
        if time.monotonic() > until_s:
            return None
        time.sleep(0.01)


def setpoints_us(
    client: BaseClient, log: Log, read_target: TargetReader, count: int, pause_s: float
) -> list[float]:
    """Send setpoints, and return the delay of each, from before the call to the first frame with a new target.

    Pauses vary, so that they do not coincide with a period of a client.
    """
    began = []
    for number in range(count):
        began.append(client.setpoint(number))
        time.sleep(pause_s * (1 + (number * 7 % 10) / 20))
    time.sleep(0.2)
    frames = [(frame.t_ns, target) for frame in log.read() if (target := read_target(frame)) is not None]
    delays, index = [], 0
    for t_ns in began:
        while index < len(frames) and frames[index][0] < t_ns:
            index += 1
        before = frames[index - 1][1] if index else None
        new = next((frame_ns for frame_ns, target in frames[index:] if target != before), None)
        if new is not None:
            delays.append((new - t_ns) / 1e3)
    if len(delays) < count * 0.9:
        raise RuntimeError(f"{count} setpoints were sent, but only {len(delays)} reached the robot")
    return delays


def computed_s(pids: list[int]) -> float:
    return sum(map(processor_s, pids))


def shares(client: BaseClient, hz: float, seconds: float) -> dict[str, float]:
    wire, others = client.pids()
    began_s, wire_s, others_s = time.monotonic(), computed_s(wire), computed_s(others)
    client.stream(hz, seconds)
    took_s = time.monotonic() - began_s
    wire_s, others_s = computed_s(wire) - wire_s, computed_s(others) - others_s
    result = {"all_pct": 100 * (wire_s + others_s) / took_s}
    return {"wire_pct": 100 * wire_s / took_s, **result} if others else result


def moving(client: BaseClient, number: int) -> threading.Thread:
    """Start a command in a thread. Return after 50 ms and a varying time, when the robot moves."""
    thread = threading.Thread(target=_quietly(lambda: client.move(number)), daemon=True)
    thread.start()
    time.sleep(MOVES_S + 0.002 * (number * 7 % 10))
    return thread


def _quietly(call: Callable[[], object]) -> Callable[[], None]:
    """Return a function that runs ``call`` and ignores its errors. A stop or a freeze may interrupt the call."""

    def run() -> None:
        with contextlib.suppress(Exception):
            call()

    return run


def stop_once(client: BaseClient, log: Log, number: int) -> float | None:
    """Return the milliseconds from the call of a stop to the first stop command that the robot receives.

    Return None if the robot was stopped before the call.
    """
    thread = moving(client, number)
    began_ns = time.monotonic_ns()
    client.stop()
    safe = first_safe(log, began_ns)
    thread.join(RETURN_S)
    before = [is_safe(frame) for frame in log.frames if frame.t_ns < began_ns and is_command(frame)]
    if before[-1:] == [True]:
        return None
    if safe is None:
        raise RuntimeError(f"the robot received no stop command within {SAFE_S:g} s after the stop")
    return (safe.t_ns - began_ns) / 1e6


def stops_ms(
    client: BaseClient, log: Log, count: int, before: Callable[[], object], after: Callable[[], object]
) -> Any:
    times_ms: list[float] = []
    for number in range(2 * count):
        before()
        took = stop_once(client, log, number)
        after()
        client.again()
        times_ms += [] if took is None else [took]
        if len(times_ms) == count:
            return times_ms
    raise RuntimeError("the robot was always stopped before the measured stop. Run this on a less busy computer")


def frozen_once(client: BaseClient, log: Log, pid: int, number: int) -> tuple[float, float]:
    """Stop a robot that is frozen. Return two times in milliseconds.

    The first one is from when the robot continues to the first stop command that it receives. The second one is the
    duration of the stop's call.
    """
    thread = moving(client, number)
    took: list[float] = []

    def stop() -> None:
        began_s = time.monotonic()
        _quietly(client.stop)()
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
        raise RuntimeError(f"the robot was frozen, and received no stop command within {SAFE_S:g} s afterwards")
    return (safe.t_ns - again_ns) / 1e6, took[0] if took else 1e3 * RETURN_S


def spread(name: str, values: list[float], unit: str = "ms") -> dict[str, float]:
    return {f"{name}_{unit}": statistics.median(values), f"{name}_worst_{unit}": max(values)}


def main(client_name: str, length: str, robot: str, hz: str, port: str, log_path: str, *service: str) -> None:
    client_class = importlib.import_module(f"{__package__}.wire_clients.{client_name}").Client
    client: BaseClient = client_class(robot, port)
    log = Log(log_path)
    pause_s = max(client.pause_s, 1 / float(hz))
    # These setpoints are a warm-up and are not measured.
    for number in range(3):
        client.setpoint(number)
        time.sleep(pause_s)
    delays = setpoints_us(client, log, TARGET_READERS.get(robot, whole), SETPOINTS[length], pause_s)
    figures = {"setpoint_p50_us": percentile(delays, 0.5), "setpoint_p95_us": percentile(delays, 0.95)}
    figures |= shares(client, float(hz), STREAM_S[length])
    figures |= spread("stop", stops_ms(client, log, STOPS[length], lambda: None, lambda: None))
    if service:
        pid, late_port, flag = service
        frozen = []
        for number in range(TROUBLED[length]):
            frozen.append(frozen_once(client, log, int(pid), number))
            client.again()
        figures |= spread("frozen_stop", [each[0] for each in frozen])
        figures["frozen_call_ms"] = statistics.median(each[1] for each in frozen)
        client.close()
        client = client_class(robot, late_port)
        late = Path(flag)
        client.setpoint(0)
        figures |= spread("late_stop", stops_ms(client, log, TROUBLED[length], late.touch, late.unlink))
    client.close()
    print(json.dumps(figures), flush=True)
    # Threads of the vendor's client would keep the process alive.
    os._exit(0)


def quicker(length: str, robot: str, usual_hz: str, hz: str, port: str) -> None:
    """Measure the processor time of this package at the control rate ``hz`` instead of ``usual_hz``."""
    ours = importlib.import_module(f"{__package__}.wire_clients.ours")
    client: BaseClient = ours.Client(
        robot, port, scale=(float(usual_hz) / float(hz)) ** 2, control_frequency=float(hz)
    )
    client.setpoint(0)
    result = shares(client, float(hz), STREAM_S[length])
    client.close()
    print(json.dumps({f"at_{float(hz):g}_hz_wire_pct": result["wire_pct"]}), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "quicker":
        quicker(*sys.argv[2:])
    else:
        main(*sys.argv[1:])

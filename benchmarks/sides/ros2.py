"""``ros2 LENGTH``: load the bridge to a ROS 2 graph, and stop an arm over it. LENGTH is ``short`` or ``long``.

The robots are simulated SO-101 arms, and one of them has a camera. A program on the graph subscribes to all of
their joint states, poses, diagnostics and pictures, while the processor time of the bridge's process is measured.
Then another bridge publishes the joint states of one arm 500 times a second, and the arm is stopped by its
service, first beside all other robots (``crowded``), and then alone. The measured time begins before the request
is sent, and ends when the twin has read the safe frame. Last, the bridge is killed or frozen while it carries out
a trajectory of this arm, and the twin's log has the time until the hold.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trio
import zenoh

from benchmarks.stage import COMMAND
from strands_actors.contract.cameras import CameraSettings, Picture
from strands_actors.kernel.channels.ros2.cdr import decode, encode
from strands_actors.kernel.channels.ros2.definitions import (
    COMPRESSED_IMAGE,
    DIAGNOSTICS,
    JOINT_STATE,
    POSE,
    TRAJECTORY,
    TRIGGER,
)
from strands_actors.kernel.channels.ros2.names import Attachment, Dialect
from strands_actors.surfaces.mesh.client import open_mesh
from strands_actors.surfaces.ros2.bridge import Options, open_bridge
from strands_actors.surfaces.ros2.samples import State

from .fleet import Arm, start
from .wire import processor_s

SIZES = {"short": (2, 4.0, 5, 1), "long": (12, 20.0, 50, 20)}
"""Number of robots, seconds of the load, number of stops, and how often the bridge is killed, and frozen."""

FLOOD_HZ = 500.0
CAMERA_HZ = 30.0
STOPPED = "arm00"
PATIENCE_S = 60.0
WAYS_RAD = (-0.6, 0.6)
"""Targets of the trajectories that a broken bridge leaves, which take ``WAY_S`` seconds."""
WAY_S = 8
PUBLISHED, MOVES_S = 10, 2.0
"""How often a trajectory is published until the arm moves, and the time between. ROS keeps no message for a
subscription that the router does not know yet. On a busy computer the first setpoint may expire, which is a hold
until the next resume."""
QUIET_S = 0.5
"""How long no setpoint may follow the hold."""
MOST_HELD = 2
"""Most trials, for each fault that is needed, in which the arm holds before the fault."""
MODULE = "benchmarks.sides.ros2"


class Noise:
    """A camera of 640 x 480 pixels with a picture that JPEG compresses to some 50 kB."""

    paced = False

    def __init__(self) -> None:
        grey = np.random.default_rng(0).integers(90, 160, (120, 160), np.uint8)
        self._image = np.repeat(np.kron(grey, np.ones((4, 4), np.uint8))[:, :, None], 3, axis=2)

    async def read(self) -> Picture:
        return Picture(self._image, time.monotonic_ns())

    async def aclose(self) -> None: ...


async def open_camera(settings: CameraSettings) -> Noise:
    return Noise()


@contextlib.contextmanager
def session(mode: str, role: str, endpoint: str) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    for key, value in (("mode", mode), (f"{role}/endpoints", [endpoint]), ("scouting/multicast/enabled", False)):
        config.insert_json5(key, json.dumps(value))
    opened = zenoh.open(config)
    try:
        yield opened
    finally:
        opened.close()  # type: ignore[no-untyped-call]  # zenoh's stubs leave it open


class Program:
    """A program on the graph, which counts the messages of each topic, and calls services."""

    def __init__(self, opened: zenoh.Session) -> None:
        self.counts: Counter[str] = Counter()
        self._session = opened
        self._numbers = itertools.count(1)
        self._subscribers: list[Any] = []

    def subscribe(self, topic: str, type_name: str) -> None:
        def count(_: zenoh.Sample) -> None:
            self.counts[topic] += 1

        self._subscribers.append(self._session.declare_subscriber(Dialect().key(topic, type_name), count))

    def follow(self, topic: str, joint: str, position: float) -> None:
        """Publish a path of one joint with one point, in radians."""
        point = {"positions": [position], "time_from_start": {"sec": WAY_S, "nanosec": 0}}
        payload = encode(TRAJECTORY, {"joint_names": [joint], "points": [point]})
        attachment = Attachment(next(self._numbers), time.time_ns(), b"benchmark client").encode()
        self._session.put(Dialect().key(topic, TRAJECTORY), payload, attachment=attachment)

    def trigger(self, service: str) -> tuple[bool, str]:
        """Call a service. Return its success and its message, or False and an empty text without a response."""
        attachment = Attachment(next(self._numbers), time.time_ns(), b"benchmark client").encode()
        replies = self._session.get(
            Dialect().key(service, TRIGGER), payload=b"\0\1\0\0\0", attachment=attachment, timeout=10.0
        )
        for reply in replies:
            if reply.ok is not None:
                answer = decode(f"{TRIGGER}_Response", reply.ok.payload.to_bytes())
                return answer["success"], answer["message"]
        return False, ""


def until(condition: Any, what: str) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline_s:
            raise SystemExit(f"not within {PATIENCE_S:g} s: {what}")
        time.sleep(0.05)


# -- the bridge


async def flood(endpoint: str) -> None:
    """Run a bridge that publishes the newest joint state of one arm again and again, each time as a new reading."""
    options = Options(router=endpoint, allow_motion=True)
    async with open_mesh() as mesh, open_bridge(mesh, options, lambda line: None) as bridge:
        while STOPPED not in bridge.nodes:  # noqa: ASYNC110  # the bridge has no event for it
            await trio.sleep(0.05)
        node = bridge.nodes[STOPPED]
        joints = dict.fromkeys(
            ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"), 0.0
        )
        began_s = trio.current_time()
        for number in itertools.count():
            node.on_sample(State(time.time(), joints, {}, 0.0))
            await trio.sleep_until(began_s + number / FLOOD_HZ)


@contextlib.contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()


# -- the parts


def load(arms: list[Arm], program: Program, pid: int, seconds: float) -> dict[str, float]:
    names = [arm.robot.name for arm in arms]
    for name in names:
        program.subscribe(f"/{name}/joint_states", JOINT_STATE)
        program.subscribe(f"/{name}/tool_pose", POSE)
    program.subscribe("/diagnostics", DIAGNOSTICS)
    image = f"/{STOPPED}/eye/image_raw/compressed"
    program.subscribe(image, COMPRESSED_IMAGE)
    until(lambda: all(program.counts[f"/{name}/tool_pose"] > 5 for name in names), "all arms on the graph")
    until(lambda: program.counts[image] > 5, "pictures")
    before, counted, began_s = processor_s(pid), program.counts.copy(), time.monotonic()
    time.sleep(seconds)
    took_s = time.monotonic() - began_s
    used_s = processor_s(pid) - before
    states = sum(program.counts[f"/{name}/joint_states"] - counted[f"/{name}/joint_states"] for name in names)
    return {
        "bridge_cores": used_s / took_s,
        "pictures_hz": (program.counts[image] - counted[image]) / took_s,
        "joint_states_hz": states / took_s,
    }


def flooded(arm: Arm, endpoint: str, count: int) -> dict[str, float]:
    """Stop the arm ``count`` times beside 500 joint states per second."""
    with running("-m", MODULE, "flood", endpoint), session("client", "connect", endpoint) as opened:
        return stops(arm, Program(opened), count)


def stops(arm: Arm, program: Program, count: int) -> dict[str, float]:
    topic = f"/{STOPPED}/joint_states"
    program.subscribe(topic, JOINT_STATE)
    counted, began_s = program.counts[topic], time.monotonic()
    until(lambda: program.counts[topic] - counted > FLOOD_HZ, "500 joint states")
    spans_ms: list[float] = []
    for _ in range(count):
        until(lambda: program.trigger(f"/{STOPPED}/resume")[0], "it is armed")
        time.sleep(0.1)
        sent_ns = time.monotonic_ns()
        confirmed, message = program.trigger(f"/{STOPPED}/stop")
        if not confirmed:
            raise SystemExit(f"a stop was not confirmed: {message or 'no response'}")
        safe = arm.log.first_safe(sent_ns)
        if safe is None:
            raise SystemExit("no safe frame")
        spans_ms.append((safe.t_ns - sent_ns) / 1e6)
    rate = (program.counts[topic] - counted) / (time.monotonic() - began_s)
    spans_ms.sort()
    return {"stop_p50_ms": spans_ms[len(spans_ms) // 2], "stop_max_ms": spans_ms[-1], "beside_hz": rate}


def moves(arm: Arm, since_ns: int) -> bool:
    """Return True as soon as the arm gets setpoints, and False if it gets no setpoint for ``MOVES_S``."""
    deadline_s = time.monotonic() + MOVES_S
    while time.monotonic() < deadline_s:
        if len(arm.log.host("setpoint", since_ns)) > 5:
            return True
        time.sleep(0.02)
    return False


def set_in_motion(arm: Arm, program: Program, rad: float) -> int:
    """Let the bridge carry out a trajectory. Return the time (ns) just before it."""
    began_ns = time.monotonic_ns()
    for _ in range(PUBLISHED):
        until(lambda: program.trigger(f"/{STOPPED}/resume")[0], "it is armed")
        program.follow(f"/{STOPPED}/joint_trajectory", "shoulder_pan", rad)
        if moves(arm, began_ns):
            return began_ns
    raise SystemExit(f"no motion after {PUBLISHED} trajectories")


def was_moving(arm: Arm, began_ns: int, broken_ns: int) -> bool:
    """Return True if the last command to the arm before the fault was a setpoint, and not a hold."""
    kinds = [
        entry.kind
        for entry in arm.log.entries(began_ns)
        if entry.sender == "host" and entry.kind in ("setpoint", "safe") and entry.t_ns < broken_ns
    ]
    return kinds[-1:] == ["setpoint"]


def breaks(arm: Arm, program: Program, endpoint: str, count: int) -> dict[str, float]:
    """Kill the bridge, and freeze it, each ``count`` times while it carries out a trajectory.

    On a busy computer a setpoint of the bridge may be late, and the arm then holds before the fault. Such a trial
    shows nothing about the fault. It is counted, and made again.
    """
    spans_ms: dict[signal.Signals, list[float]] = {signal.SIGKILL: [], signal.SIGSTOP: []}
    orders = count * list(spans_ms)
    after = held_before = 0
    program.subscribe(f"/{STOPPED}/joint_states", JOINT_STATE)
    while orders:
        order = orders[-1]
        with running("-c", COMMAND, "ros2", "--router", endpoint, "--allow-motion", STOPPED) as bridge:
            shown = program.counts[f"/{STOPPED}/joint_states"]
            until(lambda: program.counts[f"/{STOPPED}/joint_states"] > shown, "the arm on the graph")  # noqa: B023
            began_ns = set_in_motion(arm, program, WAYS_RAD[len(orders) % 2])
            time.sleep(random.random() * QUIET_S)
            broken_ns = time.monotonic_ns()
            bridge.send_signal(order)
            time.sleep(QUIET_S)
            if not was_moving(arm, began_ns, broken_ns):
                held_before += 1
                if held_before > MOST_HELD * count:
                    raise SystemExit(f"the arm held before the fault in {held_before} trials. Close other programs")
                continue
            until(lambda: arm.log.first_safe(broken_ns), "it holds")  # noqa: B023
            held = arm.log.first_safe(broken_ns)
            assert held is not None
            spans_ms[order].append((held.t_ns - broken_ns) / 1e6)
            if order is signal.SIGSTOP:
                bridge.send_signal(signal.SIGCONT)
                time.sleep(QUIET_S)
            after += arm.log.setpoints_after_safe(broken_ns)
            orders.pop()
    return {
        "hold_kill_max_ms": max(spans_ms[signal.SIGKILL]),
        "hold_freeze_max_ms": max(spans_ms[signal.SIGSTOP]),
        "setpoints_after": float(after),
        "held_before": float(held_before),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("length", choices=[*SIZES, "flood"])
    parser.add_argument("endpoint", nargs="?", default="")
    chosen = parser.parse_args()
    if chosen.length == "flood":
        trio.run(flood, chosen.endpoint)
        return
    robots, seconds, count, faults = SIZES[chosen.length]
    with socket.socket() as port:
        port.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{port.getsockname()[1]}"
    arms: list[Arm] = []
    with tempfile.TemporaryDirectory(prefix="sa-") as directory, session("router", "listen", endpoint):
        os.environ["STRANDS_ACTORS_RUN"] = directory
        try:
            for number in range(robots):
                cameras = {"eye": {"type": f"{MODULE}:open_camera", "fps": CAMERA_HZ}} if number == 0 else None
                arms.append(start(number, Path(directory), cameras=cameras))
                arms[-1].robot.release()
            with (
                running("-c", COMMAND, "ros2", "--router", endpoint) as bridge,
                session("client", "connect", endpoint) as opened,
            ):
                figures = load(arms, Program(opened), bridge.pid, seconds)
            figures |= {f"crowded_{name}": value for name, value in flooded(arms[0], endpoint, count).items()}
            while len(arms) > 1:
                arms.pop().robot.cleanup()
            figures |= flooded(arms[0], endpoint, count)
            with session("client", "connect", endpoint) as opened:
                figures |= breaks(arms[0], Program(opened), endpoint, faults)
        finally:
            for arm in arms:
                arm.robot.cleanup()
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)  # zenoh's callbacks would delay a normal exit

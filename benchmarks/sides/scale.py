"""``scale COUNT...``: stop many stand-in robots behind zenoh routers by one e-stop, and measure the cost of their
telemetry.

A stand-in publishes what an SO-101 publishes (state 10 Hz, presence 2 Hz, health 0.5 Hz, with the same names and
about the same sizes), and answers an e-stop as soon as it arrives. It has no processes, no wire and no arm. So this
measures the mesh, and not the robots.

    stand-ins (``--per-router`` each) ── router ─┐
    stand-ins ─────────────────────── router ────┼── central router ── e-stop, metrics
    ...                                          ┘

All run on this computer, over loopback. For each COUNT one JSON line has, in milliseconds, the time from a press to
the last outcome, and the processor time in percent of one core: of the central router, of all other routers, of the
stand-ins, and of the process that serves the metrics of all robots.

    python -m benchmarks.sides.scale 10 100
    python -m benchmarks.sides.scale 1000 --per-router 100 --seconds 30
"""

from __future__ import annotations

import argparse
import contextlib
import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import trio

from benchmarks.stage import at_home
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.surfaces.mesh.client import open_mesh
from strands_actors.surfaces.mesh.config import MeshConfig

from .wire import percentile, processor_s

ROUTER, ROBOTS, MADE = "router", "robots", "ready"
WAIT = "transport/link/tx/queue/congestion_control/drop/wait_before_drop"
"""zenoh's setting. Its default of 1 ms is too short for the answers of 100 robots to one e-stop: a link has room
for 16 urgent messages, and a router that gets no processor for a moment drops the others."""
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
TICK_S = 0.1
PRESENCE_EVERY, HEALTH_EVERY = 5, 20
APPEAR_S = 120.0
"""Longest time until all stand-ins have appeared."""
SETTLE_S = 3.0
"""Pause after the last stand-in has appeared. The routers may learn of its subscriptions only some time after its
token, and an e-stop before that does not reach it."""
PRESSES, PRESS_S = 10, 2.0
"""Number of e-stops, and the longest wait for their outcomes."""


def endpoint(port: int) -> str:
    return f"tcp/127.0.0.1:{port}"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


# -- the processes


async def route(port: int, central: int, wait_us: int) -> None:
    """Run a router.

    Args:
        port: Its port.
        central: Port of the router that it connects to; 0 for the central one.
        wait_us: How long it waits for room on a link before it drops a message, in microseconds.
    """
    connect = [endpoint(central)] if central else []
    await PubSub.open([endpoint(port)], connect, {"mode": "router", WAIT: wait_us})
    print(MADE, flush=True)
    await trio.sleep_forever()


class StandIn:
    """A robot that only publishes, and answers an e-stop."""

    def __init__(self, name: str, session: PubSub) -> None:
        self._name = name
        self._session = session
        self._topics = {
            topic: session.topic(mesh_json.key(name, topic), mesh_json.schema(topic))
            for topic in ("state", "presence", "health")
        }
        self._samples = {topic: mesh_json.encode(sample) for topic, sample in samples(name).items()}
        session.subscribe(mesh_json.ESTOP_KEY, self._stop)
        session.declare_token(mesh_json.key(name, "alive"))

    def publish(self, tick: int) -> None:
        for topic, every in (("state", 1), ("presence", PRESENCE_EVERY), ("health", HEALTH_EVERY)):
            if tick % every == 0 and self._topics[topic].has_subscribers:
                self._topics[topic].put(self._samples[topic])

    def _stop(self, received: Received) -> None:
        order = msgspec.json.decode(received.payload)
        sender, turn = order["sender_id"], order["turn_id"]
        motors = [{"axis": joint, "id": number, "safe": True, "detail": ""} for number, joint in enumerate(JOINTS)]
        result: dict[str, Any] = {"outcome": "safe", "safe_state": "limp", "took_ms": 4.0, "motors": motors}
        response = mesh_json.Response("response", self._name, turn, time.time(), result, final=True)
        key = mesh_json.response_key(sender, self._name, turn)
        self._session.put(key, mesh_json.encode(response), mesh_json.schema("response"))


def samples(name: str) -> dict[str, dict[str, Any]]:
    """Return a sample of each topic, as an SO-101 publishes it."""
    joints = {key: 12.345678 for joint in JOINTS for key in (joint, f"{joint}.pos")}
    task = {"status": "idle", "instruction": "", "steps": 0}
    now = time.time()
    return {
        "state": {
            "peer_id": name,
            "t": now,
            "state": "armed",
            "epoch": 3,
            "unit": "degrees (gripper: percent open)",
            "joints": joints,
            "targets": dict.fromkeys(JOINTS, 12.345678),
            "velocities": dict.fromkeys(JOINTS, 0.123456),
            "age_s": 0.004321,
            "task": task,
            "setpoints": 123456,
            "refused": {"past_travel": 3},
        },
        "presence": {
            "robot_id": name,
            "timestamp": now,
            "hw": "so101",
            "hostname": "stand-in",
            "connected": True,
            "action_keys": JOINTS,
            "model_units": {joint: [0.0, 57.29577951308232] for joint in JOINTS},
            "topics": ["presence", "state", "health"],
        },
        "health": {"peer_id": name, "t": now, "ok": True, "connected": True, "writes": 123456, "reads": 123456},
    }


async def stand_in(port: int, first: int, count: int) -> None:
    """Run stand-ins behind a router, each with a session of its own."""
    robots = []
    async with trio.open_nursery() as nursery:
        for number in range(first, first + count):
            session = await PubSub.open(connect=[endpoint(port)], settings={"mode": "client"})
            await nursery.start(session.run)
            robots.append(StandIn(f"robot{number:05}", session))
        print(MADE, flush=True)
        began_s, tick = trio.current_time(), 0
        while True:
            # The robots of a real fleet do not publish at the same moment.
            for index, robot in enumerate(robots):
                robot.publish(tick + index)
                if index % 10 == 9:
                    await trio.lowlevel.checkpoint()
            tick += 1
            await trio.sleep_until(began_s + tick * TICK_S)


# -- the measurement


@contextlib.contextmanager
def process(*words: object) -> Iterator[subprocess.Popen[str]]:
    """Run a part of this module in a process, and wait until it is ready."""
    command = [sys.executable, "-m", __name__ if __name__ != "__main__" else "benchmarks.sides.scale"]
    with subprocess.Popen([*command, *map(str, words)], stdout=subprocess.PIPE, text=True) as started:
        try:
            assert started.stdout is not None
            if started.stdout.readline().strip() != MADE:
                raise SystemExit(f"{words} did not start")
            yield started
        finally:
            started.kill()


@contextlib.contextmanager
def metrics_process(port: int, directory: Path) -> Iterator[subprocess.Popen[str]]:
    """Serve the metrics of all stand-ins."""
    file = directory / "mesh.toml"
    file.write_text(f'connect = "{endpoint(port)}"\ninsecure = true\n')
    main = "import sys; from strands_actors.surfaces.cli import run; sys.exit(run(sys.argv[1:]))"
    words = [sys.executable, "-c", main, "metrics", "--port", "0", "--mesh", str(file), "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as started:
        try:
            assert started.stdout is not None
            started.stdout.readline()
            yield started
        finally:
            started.kill()


async def press(port: int, count: int) -> dict[str, float]:
    """Stop all stand-ins by an e-stop, again and again."""
    times_ms, missing = [], 0
    async with open_mesh(MeshConfig(connect=endpoint(port), insecure=True)) as mesh:
        with trio.fail_after(APPEAR_S):
            while len(mesh.robots) < count:  # noqa: ASYNC110  # they appear one by one
                await trio.sleep(0.05)
        await trio.sleep(SETTLE_S)
        for _ in range(PRESSES):
            await trio.sleep(0.3)
            began_s = trio.current_time()
            outcomes = await mesh.estop("the benchmark", PRESS_S)
            times_ms.append((trio.current_time() - began_s) * 1e3)
            missing += count - sum(outcome.outcome == "safe" for outcome in outcomes)
    return {
        "outcomes_p50_ms": round(percentile(times_ms, 0.5), 1),
        "outcomes_worst_ms": round(max(times_ms), 1),
        "missing_outcomes": missing,
    }


def measure(count: int, per_router: int, seconds: float, wait_us: int, directory: Path) -> dict[str, float]:
    with contextlib.ExitStack() as stack:
        central_port = free_port()
        central = stack.enter_context(process(ROUTER, central_port, 0, wait_us))
        routers, robots = [], []
        for first in range(0, count, per_router):
            port = free_port()
            routers.append(stack.enter_context(process(ROUTER, port, central_port, wait_us)))
            size = min(per_router, count - first)
            robots.append(stack.enter_context(process(ROBOTS, port, first, size)))
        metrics = stack.enter_context(metrics_process(central_port, directory))
        figures: dict[str, float] = {"robots": count, "routers": len(routers) + 1}
        figures |= trio.run(press, central_port, count)
        parts = {"central_router": [central], "routers": routers, "stand_ins": robots, "metrics": [metrics]}
        before = {part: sum(processor_s(each.pid) for each in of) for part, of in parts.items()}
        began_s = time.monotonic()
        time.sleep(seconds)
        passed_s = time.monotonic() - began_s
        for part, of in parts.items():
            used_s = sum(processor_s(each.pid) for each in of) - before[part]
            figures[f"{part}_pct"] = round(100.0 * used_s / passed_s, 1)
    return figures


def main() -> None:
    if sys.argv[1:2] == [ROUTER]:
        port, central, wait_us = map(int, sys.argv[2:])
        trio.run(route, port, central, wait_us)
    if sys.argv[1:2] == [ROBOTS]:
        port, first, count = map(int, sys.argv[2:])
        trio.run(stand_in, port, first, count)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, nargs="+")
    parser.add_argument("--per-router", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--wait-us", type=int, default=100_000, help="a router waits so long for room on a link")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        at_home(f"{directory}/run")
        for robots in options.count:
            figures = measure(robots, options.per_router, options.seconds, options.wait_us, Path(directory))
            print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()

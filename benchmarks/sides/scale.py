"""``scale COUNT...``: stop many stand-in robots behind zenoh routers by one e-stop, and measure the cost of their
telemetry.

A stand-in publishes what an SO-101 publishes (state 10 Hz, presence 2 Hz, health 0.5 Hz, with the same names and
about the same sizes), and answers an e-stop as soon as it arrives. It has no processes, no wire and no arm. So this
measures the mesh, and not the robots.

    stand-ins (``--per-router`` each) ── router ─┐
    stand-ins ─────────────────────── router ────┼── central router ── e-stop, metrics
    ...                                          ┘

Each router has its stand-ins in a network namespace, if this machine allows network namespaces (``unshare -rnm``).
The namespaces are connected by a bridge of the kernel. Otherwise all run over loopback.

For each COUNT one JSON line has, in milliseconds, the time from a press to the last outcome. It also has the
processor time in percent of one core: of the central router, of all other routers, of the stand-ins, of the process
that serves the metrics of all robots, and of the console while one page shows the list of all robots.

    python -m benchmarks.sides.scale 10 100
    python -m benchmarks.sides.scale 10 100 --write           # keeps the results, and makes docs/fleet.md
    python -m benchmarks.sides.scale 1000 --estop-only --write
    python -m benchmarks.sides.scale --write                  # makes the page from the results

Two cores do not carry metrics and console of 1,000 stand-ins beside all of these. With ``--estop-only`` neither
runs, and then no telemetry is sent.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import msgspec
import trio

from benchmarks import scale_page
from benchmarks.house import Machine
from benchmarks.stage import at_home
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.surfaces.mesh.client import open_mesh
from strands_actors.surfaces.mesh.config import MeshConfig
from tests.web.browser import Visitor

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
SETTLE_S = 90.0
"""Longest time from the appearance of the last stand-in until an e-stop reaches all. The routers may learn of its
subscriptions only some time after its token, and an e-stop before that does not reach it."""
PRESSES, PRESS_S = 10, 2.0
"""Number of e-stops, and the longest wait for their outcomes."""


LOOPBACK, CENTRAL = "127.0.0.1", "10.78.0.1"
NAMESPACES = "STRANDS_ACTORS_SCALE_NAMESPACES"
"""The variable is set within the namespaces of this user, in which network namespaces may be made."""


def endpoint(port: int, host: str = LOOPBACK) -> str:
    return f"tcp/{host}:{port}"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


# -- the processes


async def route(listen: str, central: str, wait_us: int) -> None:
    """Run a router.

    Args:
        listen: Its endpoint.
        central: Endpoint of the router that it connects to; empty for the central one.
        wait_us: How long it waits for room on a link before it drops a message, in microseconds.
    """
    await PubSub.open([listen], [central] if central else [], {"mode": "router", WAIT: wait_us})
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


async def stand_in(router: str, first: int, count: int) -> None:
    """Run stand-ins behind a router, each with a session of its own. ``router`` is the router's endpoint."""
    robots = []
    async with trio.open_nursery() as nursery:
        for number in range(first, first + count):
            session = await PubSub.open(connect=[router], settings={"mode": "client"})
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


def may_enter_namespaces() -> bool:
    """Return True if this machine allows network namespaces to this user."""
    probe = ("unshare", "-rnm", "ip", "link", "add", "type", "bridge")
    return shutil.which("unshare") is not None and not subprocess.run(probe, capture_output=True).returncode


def enter_namespaces() -> NoReturn:
    """Restart this program in namespaces of this user, in which it may make network namespaces."""
    words = ["unshare", "-rnm", sys.executable, "-m", "benchmarks.sides.scale", *sys.argv[1:]]
    os.execvpe("unshare", words, os.environ | {NAMESPACES: "1"})


def ip(*words: object) -> None:
    subprocess.run(["ip", *map(str, words)], check=True)


def connect_namespaces() -> None:
    """Make the network of the central router."""
    subprocess.run(["mount", "-t", "tmpfs", "none", "/run"], check=True)
    os.mkdir("/run/netns")
    ip("link", "set", "lo", "up")
    ip("link", "add", "site", "type", "bridge")
    ip("address", "add", f"{CENTRAL}/16", "dev", "site")
    ip("link", "set", "site", "up")


@contextlib.contextmanager
def namespace(number: int) -> Iterator[tuple[str, ...]]:
    """Make a network namespace, and yield the words that run a command in it."""
    name = f"router{number}"
    ip("netns", "add", name)
    try:
        ip("link", "add", f"port{number}", "type", "veth", "peer", "name", "eth0", "netns", name)
        ip("link", "set", f"port{number}", "master", "site", "up")
        ip("-n", name, "address", "add", f"10.78.{1 + number // 250}.{1 + number % 250}/16", "dev", "eth0")
        ip("-n", name, "link", "set", "eth0", "up")
        ip("-n", name, "link", "set", "lo", "up")
        yield "ip", "netns", "exec", name
    finally:
        ip("netns", "delete", name)


@contextlib.contextmanager
def process(*words: object, within: Sequence[str] = ()) -> Iterator[subprocess.Popen[str]]:
    """Run a part of this module in a process, and wait until it is ready. ``within`` is from ``namespace``."""
    command = [*within, sys.executable, "-m", "benchmarks.sides.scale", *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as started:
        try:
            assert started.stdout is not None
            if started.stdout.readline().strip() != MADE:
                raise SystemExit(f"{words} did not start")
            yield started
        finally:
            started.kill()


@contextlib.contextmanager
def service(name: str, port: int, directory: Path) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """Run a command that serves all stand-ins: ``metrics`` or ``web``. Yield it with the facts that it prints."""
    file = directory / "mesh.toml"
    file.write_text(f'connect = "{endpoint(port)}"\ninsecure = true\n')
    main = "import sys; from strands_actors.surfaces.cli import run; sys.exit(run(sys.argv[1:]))"
    own_port = 0 if name == "metrics" else free_port()
    words = [sys.executable, "-c", main, name, "--port", str(own_port), "--mesh", str(file), "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as started:
        try:
            assert started.stdout is not None
            yield started, json.loads(started.stdout.readline())
        finally:
            started.kill()


async def press(port: int, count: int) -> dict[str, float]:
    """Stop all stand-ins by an e-stop, again and again."""
    times_ms, missing = [], 0
    async with open_mesh(MeshConfig(connect=endpoint(port), insecure=True)) as mesh:
        with trio.fail_after(APPEAR_S):
            while len(mesh.robots) < count:  # noqa: ASYNC110  # they appear one by one
                await trio.sleep(0.05)
        appeared_s = trio.current_time()
        while sum(outcome.outcome == "safe" for outcome in await mesh.estop("the benchmark", PRESS_S)) < count:
            if trio.current_time() > appeared_s + SETTLE_S:
                raise SystemExit(f"an e-stop does not reach all stand-ins within {SETTLE_S:g} s of the last one")
        settled_s = trio.current_time() - appeared_s
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
        "settled_s": round(settled_s, 1),
    }


def measure(count: int, options: argparse.Namespace, in_namespaces: bool, directory: Path) -> dict[str, float]:
    with contextlib.ExitStack() as stack:
        central_port = free_port()
        listen = endpoint(central_port, "0.0.0.0")
        central = stack.enter_context(process(ROUTER, listen, "", options.wait_us))
        routers, robots = [], []
        for number, first in enumerate(range(0, count, options.per_router)):
            within = stack.enter_context(namespace(number)) if in_namespaces else ()
            up = endpoint(central_port, CENTRAL if in_namespaces else LOOPBACK)
            own = endpoint(free_port())
            routers.append(stack.enter_context(process(ROUTER, own, up, options.wait_us, within=within)))
            size = min(options.per_router, count - first)
            robots.append(stack.enter_context(process(ROBOTS, own, first, size, within=within)))
        figures: dict[str, float] = {"robots": count, "routers": len(routers) + 1}
        if options.estop_only:
            return figures | trio.run(press, central_port, count)
        metrics, _ = stack.enter_context(service("metrics", central_port, directory))
        console, facts = stack.enter_context(service("web", central_port, directory))
        figures |= trio.run(press, central_port, count)
        stack.enter_context(stack.enter_context(Visitor(facts["url"])).page()).kind("fleet")
        parts = {
            "central_router": [central],
            "routers": routers,
            "stand_ins": robots,
            "metrics": [metrics],
            "console": [console],
        }
        before = {part: sum(processor_s(each.pid) for each in of) for part, of in parts.items()}
        began_s = time.monotonic()
        time.sleep(options.seconds)
        passed_s = time.monotonic() - began_s
        for part, of in parts.items():
            used_s = sum(processor_s(each.pid) for each in of) - before[part]
            figures[f"{part}_pct"] = round(100.0 * used_s / passed_s, 1)
    return figures


def main() -> None:
    if sys.argv[1:2] == [ROUTER]:
        trio.run(route, sys.argv[2], sys.argv[3], int(sys.argv[4]))
    if sys.argv[1:2] == [ROBOTS]:
        trio.run(stand_in, sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, nargs="*")
    parser.add_argument("--per-router", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--wait-us", type=int, default=100_000, help="a router waits so long for room on a link")
    parser.add_argument(
        "--write", action="store_true", help="keep the results, and make docs/fleet.md from all kept"
    )
    parser.add_argument(
        "--estop-only", action="store_true", help="run neither metrics nor console, so that no telemetry is sent"
    )
    parser.add_argument("--loopback", action="store_true", help="make no network namespaces")
    options = parser.parse_args()
    in_namespaces = NAMESPACES in os.environ
    if in_namespaces:
        connect_namespaces()
    elif options.count and not options.loopback and may_enter_namespaces():
        enter_namespaces()
    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        at_home(f"{directory}/run")
        for count in options.count:
            machine = Machine.current()
            figures = measure(count, options, in_namespaces, Path(directory))
            print(json.dumps(figures), flush=True)
            if options.write:
                scale_page.keep(figures, machine, in_namespaces)
    if options.write:
        scale_page.write()


if __name__ == "__main__":
    main()

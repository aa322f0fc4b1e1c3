"""A robot and its caller in two network namespaces, by hand (Linux, with ``unshare`` and ``ip``):

    python -m tests.mesh.two_hosts            three rollouts of 60 s, and a cut cable
    python -m tests.mesh.two_hosts 20         three rollouts of 20 s, and a cut cable

Each packet between the namespaces passes through this process. Each namespace has one interface, a TUN
device with its other end here. So delay, loss and a cut happen as in an IP network, and the kernel's TCP
handles them. The program prints the results from the twin's wire log.
"""

from __future__ import annotations

import fcntl
import heapq
import itertools
import json
import os
import random
import select
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from strands_actors import Robot
from strands_actors.surfaces.mesh import TLS, MeshConfig
from strands_actors.surfaces.mesh.keys import make
from strands_actors.testing import Twin
from tests.answers import json_of, state, until

ROBOT, CALLER = "10.77.0.1", "10.77.0.2"
PORT = 7447
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
PACKET = 65536
RATE_HZ = 30.0
LIFETIME_S = 0.6


class Network:
    """Carry packets between two descriptors, with a delay of ``delay_s`` each way and a share ``loss`` dropped."""

    def __init__(self, ends: tuple[int, int]) -> None:
        self._to = dict(zip(ends, reversed(ends), strict=True))
        self._random = random.Random(1)
        self.delay_s = self.loss = 0.0
        self.is_cut = self._is_over = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._is_over = True
        self._thread.join()

    def _run(self) -> None:
        waiting: list[tuple[float, int, int, bytes]] = []
        count = itertools.count()
        while not self._is_over:
            timeout_s = max(0.0, waiting[0][0] - time.monotonic()) if waiting else 0.1
            for end in select.select(list(self._to), [], [], timeout_s)[0]:
                packet = os.read(end, PACKET)
                if not self.is_cut and self._random.random() >= self.loss:
                    due_s = time.monotonic() + self.delay_s
                    heapq.heappush(waiting, (due_s, next(count), self._to[end], packet))
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, end, packet = heapq.heappop(waiting)
                if not self.is_cut:
                    os.write(end, packet)


class Host:
    """A process in a separate network namespace. ``ask`` makes it execute one command."""

    def __init__(self, role: str, home: Path, *args: str) -> None:
        ours, theirs = socket.socketpair()
        command = [sys.executable, "-m", __spec__.name, role, str(theirs.fileno()), str(home), *args]
        run = home / f"run-{role}"
        run.mkdir(mode=0o700)
        self._process = subprocess.Popen(
            ["unshare", "--user", "--map-root-user", "--net", *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            pass_fds=[theirs.fileno()],
            env={**os.environ, "STRANDS_ACTORS_RUN": str(run)},
        )
        theirs.close()
        _, fds, _, _ = socket.recv_fds(ours, 1, 1)
        self.end = fds[0]

    def ask(self, *words: object) -> Any:
        assert self._process.stdin is not None and self._process.stdout is not None
        print(json.dumps(words), file=self._process.stdin, flush=True)
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError(f"{words}: the process has ended")
        return json.loads(answer)

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(30.0)


# -- in the namespaces


def serve(role: str, sock_fd: str, home: str, *args: str) -> None:
    name = ROBOT if role == "robot" else CALLER
    end = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(end, TUNSETIFF, struct.pack("16sH22x", b"t0", IFF_TUN | IFF_NO_PI))
    for line in ("link set lo up", f"addr add {name}/24 dev t0", "link set t0 up"):
        subprocess.run(["ip", *line.split()], check=True)
    with socket.socket(fileno=int(sock_fd)) as sock:
        socket.send_fds(sock, [b"."], [end])
    keys = Path(home) / "keys"
    own_name = "so101" if role == "robot" else "operator"
    tls = TLS(*(str(keys / file) for file in ("ca.pem", f"{own_name}.pem", f"{own_name}.key")))
    if role == "robot":
        robot = Robot("so101", mode="real", port=args[0], mesh=MeshConfig(listen=f"tls/{ROBOT}:{PORT}", tls=tls))
    else:
        at, lifetime_s = f"tls/{ROBOT}:{PORT}", float(args[0])
        robot = Robot("so101", mode="real", at=at, mesh=MeshConfig(tls=tls), lifetime=lifetime_s)
    for line in sys.stdin:
        verb, *rest = json.loads(line)
        print(json.dumps(DOES[verb](robot, *rest)), flush=True)
    robot.cleanup()


def rollout(robot: Any, duration_s: float) -> Any:
    start, count = robot.get_observation()["wrist_roll"], itertools.count()

    def policy(observation: dict[str, float]) -> dict[str, float]:
        return {"wrist_roll": start + 0.3 * (next(count) % 20)}

    return json_of(robot.run_policy(policy, duration=duration_s, control_frequency=RATE_HZ))


DOES: dict[str, Any] = {
    "connect": lambda robot: robot.connect_eagerly(),
    "release": lambda robot: json_of(robot.release()),
    "resume": lambda robot: robot.resume()["status"] == "success",
    "rollout": rollout,
    "task": lambda robot: json_of(robot.get_task_status()),
    "state": state,
    "stop": lambda robot: robot.stop(),
}


# -- the measurement


def main(duration_s: float) -> None:
    with tempfile.TemporaryDirectory(prefix="two-hosts-") as folder:
        home = Path(folder)
        make(home / "keys", robots=["so101"], hosts=[ROBOT])
        with Twin("so101", home) as twin:
            robot = Host("robot", home, str(twin.port))
            caller = Host("caller", home, str(LIFETIME_S))
            network = Network((robot.end, caller.end))
            try:
                measure(twin, robot, caller, network, duration_s)
            finally:
                caller.close()
                robot.close()
                network.close()


def measure(twin: Twin, robot: Host, caller: Host, network: Network, duration_s: float) -> None:
    assert robot.ask("connect") is None
    robot.ask("release")
    assert caller.ask("connect") is None
    for title, delay_s, loss in (
        ("as it is", 0.0, 0.0),
        ("100 ms more there and back", 0.05, 0.0),
        ("100 ms more there and back, 2 % lost", 0.05, 0.02),
    ):
        network.delay_s, network.loss = delay_s, loss
        began_ns = time.monotonic_ns()
        caller.ask("rollout", duration_s)
        time.sleep(duration_s)
        until(lambda: not caller.ask("task")["running"], "it is over", within_s=duration_s + 30.0)
        task = caller.ask("task")
        print(f"{title}: {task['exit_reason']} after {task['steps']} steps; {shown(twin, began_ns)}", flush=True)
        if task["exit_reason"] != "duration":
            print(f"  {task}", flush=True)
        if caller.ask("state") != "armed":  # the network may have lost the answer
            until(lambda: caller.ask("resume"), "it is resumed")
    network.loss = 0.0
    for delay_s in (0.0, 0.05):
        network.delay_s = delay_s
        caller.ask("rollout", 60.0)
        time.sleep(3.0)
        cut_ns = time.monotonic_ns()
        network.is_cut = True
        safe = until(lambda: twin.log.first_safe(cut_ns), "a safe frame")  # noqa: B023
        held_ms = (safe.t_ns - cut_ns) / 1e6
        print(f"cut, {1e3 * delay_s:g} ms each way: held after {held_ms:.0f} ms, lifetime {1e3 * LIFETIME_S:g}")
        print(f"  there {robot.ask('state')}, here {caller.ask('state')}; stop: {caller.ask('stop')}", flush=True)
        print(f"  setpoints after it: {twin.log.setpoints_after_safe(cut_ns)}", flush=True)
        network.is_cut = False
        until(lambda: caller.ask("state") == "holding", "it is reached again", within_s=60.0)
        print(f"  healed: setpoints after it: {twin.log.setpoints_after_safe(cut_ns)}", flush=True)
        until(lambda: caller.ask("resume"), "it is resumed")


def shown(twin: Twin, since_ns: int) -> str:
    setpoints = [entry.t_ns for entry in twin.log.host("setpoint", since_ns)]
    gaps_ms = [(after - before) / 1e6 for before, after in itertools.pairwise(setpoints)]
    held = sum(1 for entry in twin.log.entries(since_ns) if entry.safe_state)
    longest_ms = max(gaps_ms, default=0.0)
    return f"{len(setpoints)} setpoints on the wire, longest gap {longest_ms:.0f} ms, {held} safe frames"


if __name__ == "__main__":
    if sys.argv[1:2] in (["robot"], ["caller"]):
        serve(*sys.argv[1:])
    else:
        main(float(sys.argv[1]) if sys.argv[1:] else 60.0)

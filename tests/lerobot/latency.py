"""From a leader arm to its follower, by hand, in one of the environments:

    python -m tests.lerobot.latency 30              so many seconds of each row
    python -m tests.lerobot.latency 30 ours theirs  of these rows

An SO-101's leader is moved by hand all the time; read is what stands on the two wires. ``theirs`` is
LeRobot's own ``lerobot-teleoperate`` with its own classes of leader, follower and camera. A picture
is 640 x 480, 30 a second.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from strands_actors import Robot, Teleoperator
from strands_actors.testing import Twin
from strands_actors.testing.trials import subject
from strands_actors.testing.wirelog import Entry
from tests.answers import json_of, task, until

from .calibration import MOTORS, NAME, write
from .commands import start
from .their_log import SYNC_WRITE, packet_of, rows_of

HZ = 100
CAMERAS = 4
PICTURES = {"fps": 30, "width": 640, "height": 480}
STARTS_S = 180.0
REACH_RAD = 0.3
"""The first joint is moved to and fro, about so far."""
APART, SAME = 3, 1
"""Counts: so far a reading is from the one before, to be told from it; so near is a goal to its reading."""
AT_REST_DEG = 4.0
LATEST_NS = 200_000_000
"""Later than this a reading was passed over."""
REST = dict.fromkeys(MOTORS[:-1], 0.0)
PRESS_S = 4.0
PAUSE_S = 0.2, 0.4
MOVES = 50
"""Setpoints: it leads."""
ATTACK_S = 1.0
FROZEN_S = 0.5
MOMENTS_NS = 500_000
READ, SYNC_READ, POSITION = 2, 0x82, 56
"""Feetech's instructions, and its register of the present position."""


class Row(NamedTuple):
    cameras: int
    attack: str = ""


ROWS = {
    "theirs": Row(CAMERAS),
    "ours": Row(CAMERAS),
    "no camera": Row(0),
    "killed": Row(CAMERAS, "kill"),
    "frozen": Row(CAMERAS, "freeze"),
    "flood": Row(CAMERAS, "flood"),
}


class Seen(NamedTuple):
    """Milliseconds. ``change``: from a change of the leader's position to the follower's frame with it,
    for changes at every moment between two readings; ``reply``: from the reading; ``gaps``: between two
    frames to the follower."""

    change: list[float]
    reply: list[float]
    gaps: list[float]
    missed: int


def main() -> None:
    seconds, names = float(sys.argv[1]), sys.argv[2:] or list(ROWS)
    print(f"lerobot {version('lerobot')}", *subject().values(), sep="; ")
    print("a leader's change / its reading to the follower's frame, and between frames: p50, p99, worst, in ms")
    with tempfile.TemporaryDirectory(prefix="latency-") as folder:
        home = Path(folder)
        os.environ |= {"HF_HOME": folder, "HF_HUB_OFFLINE": "1", "STRANDS_ACTORS_RUN": folder}
        for name in ("leader", "follower"):
            (home / name).mkdir()
        write(home)
        with (
            Twin("so101_leader", home / "leader", by_hand=True) as leader,
            Twin("so101", home / "follower") as follower,
        ):
            for name in names:
                leader.move_by_hand(**REST, gripper=0.8)
                led = _theirs if name == "theirs" else _ours
                with led(ROWS[name], leader, follower, home):
                    _tell(name, _measured(seconds, leader, follower))


def _tell(name: str, seen: Seen) -> None:
    figures = (_figures(values) for values in (seen.change, seen.reply, seen.gaps))
    load = os.getloadavg()[0]
    print(
        f"{name:10}",
        *figures,
        f"{len(seen.reply)} readings, {seen.missed} without a frame, load {load:.1f}",
        flush=True,
    )


def _figures(values: Sequence[float]) -> str:
    if len(values) < 2:
        return "none"
    p99 = statistics.quantiles(values, n=100)[98]
    return f"{statistics.median(values):6.2f} {p99:6.2f} {max(values):6.2f} |"


# -- who leads


@contextlib.contextmanager
def _theirs(row: Row, leader: Twin, follower: Twin, home: Path) -> Iterator[None]:
    cameras = {f"c{at}": {"type": "steady", "index_or_path": at, **PICTURES} for at in range(row.cameras)}
    process = until(lambda: _led(leader, follower, home, cameras), "it leads", STARTS_S)
    try:
        yield
        assert process.poll() is None, "lerobot-teleoperate has ended"
    finally:
        process.kill()
        process.wait()


def _led(leader: Twin, follower: Twin, home: Path, cameras: Mapping[str, Any]) -> subprocess.Popen[str] | None:
    """None: it did not connect, as on a busy machine, where it asks a servo once."""
    os.truncate(follower.log.path, 0)
    process = start(
        "teleoperate", home, "--robot.type=so101_follower", f"--robot.port={follower.port}", f"--robot.id={NAME}",
        f"--robot.calibration_dir={home}", "--robot.discover_packages_path=tests.lerobot.steady",
        f"--robot.cameras={json.dumps(cameras)}", "--teleop.type=so101_leader", f"--teleop.port={leader.port}",
        f"--teleop.id={NAME}", f"--teleop.calibration_dir={home}", f"--fps={HZ}",
    )  # fmt: skip
    threading.Thread(target=process.communicate, daemon=True).start()  # it prints each cycle
    until(lambda: process.poll() is not None or len(follower.log.host("setpoint")) > MOVES, "it leads", STARTS_S)
    return None if process.poll() is not None else process


@contextlib.contextmanager
def _ours(row: Row, leader: Twin, follower: Twin, home: Path) -> Iterator[None]:
    kinds = ["flood" if row.attack == "flood" and not at else "steady" for at in range(row.cameras)]
    cameras = {f"c{at}": {"type": f"tests.cameras.sources:{kind}", **PICTURES} for at, kind in enumerate(kinds)}
    arm = Robot("so101", mode="real", port=follower.port, cameras=cameras)
    done = threading.Event()
    helpers = [threading.Thread(target=_press, args=(arm, done))]
    if row.attack in ATTACKS:
        helpers.append(threading.Thread(target=_attack, args=(arm, ATTACKS[row.attack], done)))
    try:
        until(lambda: arm.connect_eagerly() is None, "it connects", STARTS_S)
        json_of(arm.send_action(REST))
        until(lambda: all(abs(arm.get_observation()[axis]) < AT_REST_DEG for axis in REST), "it rests", STARTS_S)
        json_of(arm.release())
        json_of(arm.attach_teleop(Teleoperator("so101_leader", port=leader.port), HZ, deadman="key"))
        until(lambda: _sees(arm, cameras), "the cameras see", STARTS_S)
        for helper in helpers:
            helper.start()
        until(lambda: _teleop(arm).get("state") == "engaged", "it is engaged", STARTS_S)
        yield
    finally:
        done.set()
        for helper in helpers:
            if helper.ident is not None:
                helper.join()
        arm.cleanup()


def _teleop(arm: Any) -> dict[str, Any]:
    told: dict[str, Any] = task(arm).get("teleop", {})
    return told


def _sees(arm: Any, cameras: Any) -> bool:
    told = json_of(arm.get_status()).get("cameras", {})
    return all(told[name]["state"] == "streaming" for name in cameras)


def _press(arm: Any, done: threading.Event) -> None:
    """Hold the dead-man; let go for a moment where a press did not engage."""
    while not done.is_set():
        until_s = time.monotonic() + PRESS_S
        while not done.is_set() and (time.monotonic() < until_s or _teleop(arm).get("state") == "engaged"):
            arm.operate(True)
            done.wait(0.05)
        arm.operate(False)
        done.wait(0.1)


def _kill(pid: int, done: threading.Event) -> None:
    os.kill(pid, signal.SIGKILL)


def _freeze(pid: int, done: threading.Event) -> None:
    os.kill(pid, signal.SIGSTOP)
    done.wait(FROZEN_S)
    with contextlib.suppress(ProcessLookupError):  # it was replaced
        os.kill(pid, signal.SIGCONT)


ATTACKS: dict[str, Callable[[int, threading.Event], None]] = {"kill": _kill, "freeze": _freeze}


def _attack(arm: Any, how: Callable[[int, threading.Event], None], done: threading.Event) -> None:
    """Once a second, the first camera's process."""
    while not done.wait(ATTACK_S):
        pids = [one["pid"] for one in arm.tree()["processes"] if one["role"].endswith("c0") and one["pid"]]
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                how(pid, done)


# -- what the wires show


def _measured(seconds: float, leader: Twin, follower: Twin) -> Seen:
    for twin in (leader, follower):
        os.truncate(twin.log.path, 0)
    until_s, side = time.monotonic() + seconds, 1
    while time.monotonic() < until_s:
        side = -side
        leader.move_by_hand(shoulder_pan=side * random.uniform(0.5, 1.0) * REACH_RAD)
        time.sleep(random.uniform(*PAUSE_S))
    written = [entry for entry in follower.log.host("setpoint") if packet_of(entry.data).code == SYNC_WRITE]
    goals = [(entry.t_ns, _counts(rows_of(packet_of(entry.data))[1])) for entry in written]
    return _seen(list(_told(leader.log.entries())), goals)


def _seen(told: Sequence[tuple[int, int]], goals: Sequence[tuple[int, int]]) -> Seen:
    """``told``: when the leader said where its first joint is; ``goals``: when the follower was told
    where to go. A reading that was passed over for a newer one counts with that."""
    change, reply, missed = [], [], 0
    since_ns = told[0][0]  # of the first change that the follower has not been told
    replies = _replies(told, goals)
    for ((_, before), (at_ns, counts)), goal_ns in zip(itertools.pairwise(told), replies[1:], strict=True):
        if abs(counts - before) < APART:
            since_ns = at_ns
            continue
        if goal_ns is None or goal_ns > at_ns + LATEST_NS:
            missed += 1
            continue
        reply.append((goal_ns - at_ns) / 1e6)
        change += [(goal_ns - moment_ns) / 1e6 for moment_ns in range(at_ns, since_ns, -MOMENTS_NS)]
        since_ns = at_ns
    gaps = [(late - soon) / 1e6 for (soon, _), (late, _) in itertools.pairwise(goals)]
    return Seen(change, reply, gaps, missed)


def _replies(told: Sequence[tuple[int, int]], goals: Sequence[tuple[int, int]]) -> list[int | None]:
    """Return for each reading when the follower was first told to go where it, or a newer one, says."""
    replies: list[int | None] = [None] * len(told)
    answered = newest = 0
    for goal_ns, goal in goals:
        while newest < len(told) and told[newest][0] < goal_ns:
            newest += 1
        near = (at for at in range(newest - 1, answered - 1, -1) if abs(told[at][1] - goal) <= SAME)
        source = next(near, answered - 1)
        replies[answered : source + 1] = [goal_ns] * (source + 1 - answered)
        answered = max(answered, source + 1)
    return replies


def _told(entries: Iterable[Entry]) -> Iterator[tuple[int, int]]:
    """When the leader says where its first joint is, and where. Who asks begins at a
    register of their own."""
    first = POSITION
    for entry in entries:
        data = entry.data
        while len(data) > 5 and data.startswith(b"\xff\xff"):
            size = 4 + data[3]
            packet = packet_of(data[:size])
            data = data[size:]
            if entry.sender == "host" and packet.code in (READ, SYNC_READ):
                first = packet.params[0]
            elif entry.sender == "robot" and packet.id == 1 and packet.params[POSITION - first :]:
                yield entry.t_ns, _counts(packet.params[POSITION - first :])


def _counts(position: bytes) -> int:
    return int.from_bytes(position[:2], "little")


if __name__ == "__main__":
    main()

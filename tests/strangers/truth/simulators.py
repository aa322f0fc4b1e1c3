"""The simulators that others publish, and how each is started."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from datetime import date
from pathlib import Path
from typing import Any, NamedTuple

import httpx

from benchmarks import peers
from strands_actors.testing import Twin
from tests.ports import free_port

from ..fetch import NotFetched, fetch
from ..run import STUBS
from ..table import Client
from ..verdict import last_line
from . import by_client, reachy
from .compare import Event, absent_of, result_of

START_S = 300.0
"""Timeout for the start of a simulator on a busy machine."""

END_S = 3.0
"""How long a simulator that has failed goes on running, in seconds."""
LISTEN = "0A"
"""The state of a listening socket in /proc/net/tcp."""

Session = Callable[[str], Iterator[Event]]
"""Runs the session against an address, and yields its events."""


class Simulator(NamedTuple):
    """A simulator of others, and the session that is run on it and on our twin.

    Attributes:
        title: Its name and version for the page.
        robot: Our robot.
        options: Options of our twin, so that it is the robot that the simulator simulates.
        start: Starts the simulator, and gives its address.
        session: The session.
        note: What explains a difference, for the page.
    """

    title: str
    robot: str
    options: Mapping[str, Any]
    start: Callable[[Path], AbstractContextManager[str]]
    session: Session
    note: str = ""


@contextlib.contextmanager
def reachy_daemon(folder: Path) -> Iterator[str]:
    """Run the daemon of Reachy Mini with its own simulation in MuJoCo."""
    try:
        python = peers.python("reachy")
    except peers.Missing:
        peers.make("reachy")
        python = peers.python("reachy")
    port = free_port()
    options = "--headless --no-media --no-wake-up-on-start --no-goto-sleep-on-stop --no-preload-datasets"
    command = [str(Path(python).with_name("reachy-mini-daemon")), "--sim", *options.split()]
    command += ["--dataset-update-interval", "0", "--fastapi-port", str(port)]
    environment = {**os.environ, "PYTHONPATH": str(STUBS), "HOME": str(folder)}
    address = f"127.0.0.1:{port}"
    with running(command, environment, folder / "daemon.log", lambda: _is_running(address)):
        yield address


def _is_running(address: str) -> bool:
    try:
        answer = httpx.get(f"http://{address}/api/daemon/status", trust_env=False, timeout=5.0)
        return bool(answer.json()["state"] == "running")
    except (httpx.HTTPError, ValueError):
        return False


FRANKA_HOST = "127.77.0.1"
"""An address of this computer that no twin uses, so that the fixed port is free."""
FRANKA_PORT = 1337


# Its command serves at every address of the computer, so that no twin could use the port.
FRANKA_SIM = f"""
from franka_sim.franka_sim_server import FrankaSimServer
FrankaSimServer(host="{FRANKA_HOST}", enable_gripper=False, enforce_motion_limits=True).start()
"""


@contextlib.contextmanager
def franka_sim(folder: Path) -> Iterator[str]:
    """Run franka-sim with the arm alone."""
    python = _environment("franka-sim", "1.1.7")
    with running(
        [str(python), "-c", FRANKA_SIM], dict(os.environ), folder / "sim.log", lambda: is_listening(FRANKA_PORT)
    ):
        yield FRANKA_HOST


@contextlib.contextmanager
def franky_sim(folder: Path) -> Iterator[str]:
    """Run franky-sim with one arm."""
    python = _environment("franky-sim", "1.0.4")
    command = [str(python.with_name("franky-sim")), "--hostname", FRANKA_HOST, "--simulator", "mujoco"]
    with running(command, dict(os.environ), folder / "sim.log", lambda: is_listening(FRANKA_PORT)):
        yield FRANKA_HOST


UNITREE_FOLDER = "STRANDS_ACTORS_UNITREE_MUJOCO"
"""The environment variable that names a checkout of unitree_mujoco, which is in no package index."""
UNITREE = "https://github.com/unitreerobotics/unitree_mujoco", "c598f10"


@contextlib.contextmanager
def unitree_mujoco(folder: Path) -> Iterator[str]:
    """Run Unitree's simulator with a Go2, without its screen."""
    checkout = os.environ.get(UNITREE_FOLDER)
    if checkout is None:
        repository, commit = UNITREE
        raise RuntimeError(f"{UNITREE_FOLDER} names no checkout of {repository} at {commit}")
    python = fetch(Client(name="mujoco", version="3.3.7", license="", robot="", needs=("pygame",))).python
    client = by_client.fetched("unitree-sdk2py-dimos").python
    (packages,) = client.parents[1].glob("lib/python*/site-packages")
    log = folder / "sim.log"
    command = [str(python), str(Path(__file__).with_name("unitree_simulator.py")), f"{checkout}/simulate_python"]
    environment = {
        **os.environ,
        "PYTHONPATH": str(packages),
        "SDL_VIDEODRIVER": "dummy",
        "SDL_AUDIODRIVER": "dummy",
    }
    with running(command, environment, log, lambda: "ready" in log.read_text(errors="replace")):
        yield "127.0.0.1"


def _environment(name: str, version: str) -> Path:
    """Return the Python of the environment of a simulator."""
    return fetch(Client(name=name, version=version, license="", robot="fr3")).python


def is_listening(port: int) -> bool:
    """Return True if a server listens on this port of ``FRANKA_HOST``. It is not connected to (proc(5))."""
    host = int.from_bytes(socket.inet_aton(FRANKA_HOST), sys.byteorder)
    rows = Path("/proc/net/tcp").read_text().splitlines()[1:]
    return any(row.split()[1] == f"{host:08X}:{port:04X}" and row.split()[3] == LISTEN for row in rows)


@contextlib.contextmanager
def running(
    command: Sequence[str], environment: Mapping[str, str], log: Path, is_ready: Callable[[], bool]
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program as long as the ``with`` block, which begins when it is ready.

    Raises:
        RuntimeError: The program ended, or is not ready in time. The text has the end of its output.
    """
    with log.open("wb") as output:
        process = subprocess.Popen(
            command, env=environment, stdout=output, stderr=output, stdin=subprocess.DEVNULL, start_new_session=True
        )
        try:
            deadline_s = time.monotonic() + START_S
            while not is_ready():
                if process.poll() is not None or time.monotonic() > deadline_s:
                    raise RuntimeError(f"{command[0]} does not run: {log.read_text(errors='replace')[-2000:]}")
                time.sleep(0.1)
            yield process
            # A program may begin to listen, and end with an error while it builds its world.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
                raise RuntimeError(log.read_text(errors="replace")[-4000:])
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


FRANKY_NOTE = (
    "It has a hand (0.103 m), so its end effector is lower. Its torques contain gravity: franka-sim 1.1.7 and our "
    "twin report them without [assumed of the real arm]. It has no guard against a jump."
)
UNITREE_NOTE = (
    "It steps by 5 ms and sends one state for each step; a robot and our twin send 500 a second. It leaves the "
    "head of a state empty. It runs here without its screen, which its own main program needs."
)
SIMULATORS: Mapping[str, Simulator] = {
    "franka-sim": Simulator("franka-sim 1.1.7", "fr3", {}, franka_sim, by_client.franka),
    "franky-sim": Simulator("franky-sim 1.0.4", "fr3", {}, franky_sim, by_client.franka, FRANKY_NOTE),
    "unitree_mujoco": Simulator(
        "unitree_mujoco (c598f10)",
        "unitree_go2",
        {"simulator": True},
        unitree_mujoco,
        by_client.unitree,
        UNITREE_NOTE,
    ),
    "reachy-mini": Simulator(
        "reachy-mini-daemon 1.13.0 --sim",
        "reachy_mini",
        {"wireless": False, "media": False},
        reachy_daemon,
        reachy.session,
        "The simulated daemon keeps its torque in every mode, so it moves while the torque should be off.",
    ),
}


def compare(name: str) -> dict[str, Any]:
    """Run the session on a simulator and on our twin, one after the other, and return the result."""
    simulator, today = SIMULATORS[name], date.today().isoformat()
    with tempfile.TemporaryDirectory(prefix="strangers-") as temporary:
        try:
            with simulator.start(Path(temporary)) as address:
                theirs = list(simulator.session(address))
        except (RuntimeError, NotFetched, peers.Missing) as reason:
            return absent_of(name, simulator.title, simulator.robot, last_line(str(reason)), today)
        with Twin(simulator.robot, Path(temporary), options=simulator.options) as twin:
            ours = list(simulator.session(twin.port))
    result = result_of(name, simulator.title, simulator.robot, theirs, ours, today)
    return {**result, "note": simulator.note}


__all__ = ["SIMULATORS", "Simulator", "compare", "running"]

"""``web``: serve the console, in which a person watches, stops and moves robots."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import msgspec
import trio

from strands_actors.caller.processes.run_directory import data_dir
from strands_actors.contract.extras import require
from strands_actors.kernel.processes.interpreter import PYTHON, environment

from .errors import Problem
from .orders import configuration
from .until_signal import mesh_until_signal

_SIMULATED = """
import signal, sys, threading
from strands_actors import Robot
robot = Robot(sys.argv[1])
robot.connect_eagerly()
robot.release()
print("runs", flush=True)
ended = threading.Event()
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda *_: ended.set())
ended.wait()
robot.cleanup()
"""
LEAVE_S = 10.0


class Choice(msgspec.Struct, frozen=True):
    """The options of the command line.

    Attributes:
        robot: The robot that the page shows first; empty for the list of all robots.
        twins: Types of simulated robots to start.
        port: The port of the console. The e-stop gets the next one.
        lan: Serve other devices of the network, too.
        name: Name or address of this computer for other devices; empty to find out.
        recordings: Folder of datasets and recordings; None for the usual one.
        agent: ``module:function`` that makes the agent; empty for no agent.
        models: Model files of the user, each ``NAME=FILE``.
    """

    robot: str
    twins: Sequence[str]
    port: int
    lan: bool
    name: str
    recordings: Path | None = None
    agent: str = ""
    models: Sequence[str] = ()


def web(choice: Choice, mesh: Path | None, as_json: bool) -> None:
    """Serve the console until Ctrl-C.

    Raises:
        Problem: A port is in use, or a simulated robot does not start.
    """
    require("web", "web")
    if choice.agent:
        _check_agent(choice.agent)
    models = _models(choice.models)
    with contextlib.ExitStack() as stack:
        for twin in choice.twins:
            stack.enter_context(_simulated(twin))
        trio.run(_serve, choice, mesh, as_json, models)


async def _serve(choice: Choice, mesh: Path | None, as_json: bool, models: Mapping[str, str]) -> None:
    from strands_actors.surfaces.web.certificates import certificate_for, own_name
    from strands_actors.surfaces.web.qr import qr_terminal
    from strands_actors.surfaces.web.serving import CannotListen, ChosenAgent, Lan, Serving, serve

    lan = None
    if choice.lan:
        name = choice.name or own_name()
        lan = Lan(name, certificate_for(name, data_dir() / "console"))
    first = choice.robot or next(iter(choice.twins), "")

    def on_serving(serving: Serving) -> None:
        url = f"{serving.url}&robot={first}" if first else serving.url
        if as_json:
            print(json.dumps({**msgspec.to_builtins(serving), "url": url}), flush=True)
            return
        print(f"console: {url}\ne-stop alone: {serving.estop} (open the console first)", flush=True)
        if serving.pairing:
            print(f"another device: {serving.pairing}\n{qr_terminal(serving.pairing)}", flush=True)
            print(f"its certificate: {serving.fingerprint}", flush=True)
        print("Ctrl-C ends this", flush=True)

    agent = ChosenAgent(choice.agent, str(mesh) if mesh is not None else "")
    async with mesh_until_signal(mesh) as client:
        try:
            await serve(client, configuration(mesh), choice.port, lan, on_serving, choice.recordings, agent, models)
        except CannotListen as reason:
            raise Problem(f"web: {reason}. Give another --port") from reason


def _models(given: Sequence[str]) -> dict[str, str]:
    """Return the model files by name of the robot. Raise ``Problem`` if one is not ``NAME=FILE``, or is missing."""
    files = {}
    for text in given:
        robot, _, file = text.partition("=")
        if not robot or not Path(file).is_file():
            raise Problem(
                f"web: --model-file {text} names no file. Give NAME=FILE, with the MJCF or URDF of a robot"
            )
        files[robot] = file
    return files


def _check_agent(factory: str) -> None:
    """Raise ``Problem`` if no agent can be made by this name. The agent's process loads the function itself."""
    module, colon, function = factory.partition(":")
    if importlib.util.find_spec("strands") is None:
        raise Problem("web: --agent needs strands-agents. pip install 'strands-actors[agent]'")
    try:
        is_found = bool(colon and function) and importlib.util.find_spec(module) is not None
    except (ImportError, ValueError) as error:
        raise Problem(f"web: --agent {factory} cannot be used: {error}") from error
    if not is_found:
        raise Problem(
            f"web: --agent {factory} names no function of a module that Python finds. Give MODULE:FUNCTION, and "
            "set PYTHONPATH to the module's folder"
        )


@contextlib.contextmanager
def _simulated(robot: str) -> Iterator[None]:
    """Run a simulated robot in a process of its own while the block runs. No script commands it."""
    process = subprocess.Popen(
        [*PYTHON, "-c", _SIMULATED, robot],
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C goes to this command, which then ends the robot.
        text=True,
    )
    assert process.stdout is not None
    try:
        if not process.stdout.readline():
            raise Problem(f"web: no simulated {robot} could be started. `strands-actors list` shows the robots")
        yield
    finally:
        process.terminate()
        try:
            process.wait(LEAVE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()

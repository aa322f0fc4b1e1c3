"""Functions of the mesh for programs without trio."""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any

import msgspec
import trio

from strands_actors.caller.handle.forked import command_line
from strands_actors.caller.session.portal import forked_from, portal
from strands_actors.contract.shown import closest, shown
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh.schemas import ESTOP_ANSWER_S, Execute

from .client import AWAY_S, STOP_S, MeshClient, open_mesh
from .config import MeshConfig
from .mapping_commands import peers, send, send_to_all, stops
from .outcome import UNREACHABLE, Outcome
from .sessions import EVERYBODY, OTHERS

Mesh = MeshConfig | str | os.PathLike[str] | None
"""How to reach robots on other hosts: a configuration, or the path of its file. None stands for the file
that ``STRANDS_ACTORS_MESH`` names."""

_SET = ("action", "instruction", "clock", "deadline_ns")
OPTIONS = tuple(name for name in Execute.__struct_fields__ if name not in _SET)
"""Names of the options of ``tell``."""

_log = logging.getLogger("strands_actors")


def estop(*, mesh: Mesh = None, by: str = "", within_s: float = ESTOP_ANSWER_S) -> list[Outcome]:
    """Stop every robot on the mesh, and lock each one until it is resumed. Call it from any thread.

    The stop is sent even if an argument is wrong. If ``mesh`` cannot be used, the stop reaches only the robots
    of this user, and one outcome reports that no robots of other hosts were reached.

    Args:
        mesh: How to reach robots on other hosts.
        by: The name that the robots report as the origin of the stop. Default: this program.
        within_s: How long to wait for the results, at least 0.25 s.

    Returns:
        The result of each known robot: safe, unconfirmed or unreachable.
    """

    async def run() -> list[Outcome]:
        async with open_mesh(mesh, to_stop=True) as client:
            return await client.estop(by, within_s)

    return _estop_from_child(mesh) if forked_from() else portal().call(run)


def _estop_from_child(mesh: Mesh) -> list[Outcome]:
    """Send the e-stop by running the command line. A process that was forked from a program with robots cannot
    open a zenoh session."""
    named = ("--mesh", os.fspath(mesh)) if isinstance(mesh, str | os.PathLike) else ()
    result = command_line("estop", *named, within_s=STOP_S)
    if "robots" not in result:
        return [Outcome(EVERYBODY, UNREACHABLE, str(result.get("error")))]
    fields = Outcome.__struct_fields__
    rows = [{key: value for key, value in row.items() if key in fields} for row in result["robots"]]
    outcomes = [msgspec.convert({"outcome": UNREACHABLE, **row}, Outcome) for row in rows]
    if isinstance(mesh, MeshConfig):
        reason = "a forked process cannot use a MeshConfig. Give the path of its file"
        outcomes.append(Outcome(OTHERS, UNREACHABLE, reason))
    return outcomes


def _check_name(verb: str, robot: object) -> None:
    if not isinstance(robot, str):
        raise TypeError(f"{verb}: the robot is {shown(robot)}. Give the name of a robot, as text")


@contextlib.contextmanager
def estop_button(*, mesh: Mesh = None, by: str = "") -> Iterator[Callable[[], list[Outcome]]]:
    """Connect to the mesh in advance, for a program that may have to stop robots at any moment.

    The block begins when the known robots have appeared, or after half a second. It stays connected until its
    end. If ``mesh`` cannot be used, this is logged at once and reported in the outcomes of each press.

    Args:
        mesh: How to reach robots on other hosts.
        by: The name that the robots report as the origin of the stop. Default: this program.

    Yields:
        A function like ``estop``. Call it from any thread, any number of times. The calling thread sends the
        stop itself, before it waits for anything.
    """
    joined: Future[MeshClient] = Future()

    async def stay() -> None:
        async with open_mesh(mesh, to_stop=True) as client:
            await client.settle()  # Otherwise the first press could come before a robot is connected.
            for lost in client.not_looked_for():
                _log.warning("estop_button: %s: %s", lost.robot, lost.detail)
            joined.set_result(client)
            await trio.sleep_forever()

    staying = portal().submit(stay)
    either: list[Future[Any]] = [joined, staying]
    wait(either, return_when=FIRST_COMPLETED)
    if staying.done():
        staying.result()  # This raises the exception that ended the connection.
    client = joined.result()

    def press() -> list[Outcome]:
        if staying.done():
            raise RuntimeError("the with block of estop_button has ended. Press inside the block, or call estop()")
        pressed = client.press(by)
        time.sleep(AWAY_S)
        return portal().call(client.outcomes, pressed)

    try:
        yield press
    finally:
        staying.cancel()


def get_peers(*, mesh: Mesh = None) -> list[dict[str, Any]]:
    """Return the robots on the mesh, within 1.5 s. Each row has ``peer_id``, ``type``, ``age`` (seconds since
    its presence message has come), ``reachable`` (whether one has come), and the fields of this message."""

    async def run() -> list[dict[str, Any]]:
        async with open_mesh(mesh) as client:
            return await peers(client)

    return portal().call(run)


def tell(robot: str, instruction: str, *, mesh: Mesh = None, **options: Any) -> dict[str, Any]:
    """Run a policy on a robot of the mesh, and wait until it has ended. The policy must be installed on the
    robot's host.

    Args:
        robot: The name of the robot.
        instruction: The instruction for the policy.
        mesh: How to reach robots on other hosts.
        options: ``policy_provider`` names the policy. ``duration``, ``n_steps``, ``policy_port``,
            ``policy_host`` and ``control_frequency`` are as for ``start_task``.

    Returns:
        The status of the task at its end.

    Raises:
        PermissionError: The robot has refused. The text is its refusal.
        TypeError: ``robot`` is not a name, or an option is unknown.
    """
    _check_name("tell", robot)
    for option in options:
        if option not in OPTIONS:
            close = closest(option, OPTIONS)
            hint = f" ({close[0]!r}?)" if close else ""
            raise TypeError(f"tell: there is no option {option!r}{hint}. Use {', '.join(OPTIONS)}")

    async def run() -> dict[str, Any] | Refused:
        async with open_mesh(mesh) as client:
            return await send(client, robot, {"action": "execute", "instruction": instruction, **options})

    answer = portal().call(run)
    if isinstance(answer, Refused):
        raise PermissionError(answer.text)
    return answer


def broadcast(command: Mapping[str, Any] | str, *, mesh: Mesh = None) -> list[dict[str, Any]]:
    """Send a reading command (``"status"``, ``"state"``, ``"ping"``) or a stop to all robots of the mesh.

    Returns:
        One row per robot: ``responder_id``, and ``result`` or ``error``.

    Raises:
        PermissionError: The command cannot be sent to all robots at once.
    """

    async def run() -> dict[str, dict[str, Any] | Refused] | Refused:
        async with open_mesh(mesh, to_stop=stops(command)) as client:
            return await send_to_all(client, command)

    answers = portal().call(run)
    if isinstance(answers, Refused):
        raise PermissionError(answers.text)
    return [
        {"responder_id": name, **({"error": answer.text} if isinstance(answer, Refused) else {"result": answer})}
        for name, answer in answers.items()
    ]


def resume(robot: str, *, mesh: Mesh = None, by: str = "") -> None:
    """Lift the lockout of one robot and energise it at the measured position.

    Raises:
        PermissionError: The robot has refused. The text is its refusal.
        TypeError: ``robot`` is not a name.
    """
    _check_name("resume", robot)

    async def run() -> None:
        async with open_mesh(mesh) as client:
            answer = await client.resume(robot, by)
        if isinstance(answer, Refused):
            raise PermissionError(answer.text)

    portal().call(run)

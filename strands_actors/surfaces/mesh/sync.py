"""The mesh for programs without trio."""

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

from strands_actors.caller.forked import command_line
from strands_actors.caller.portal import forked_from, portal
from strands_actors.contract.shown import closest, shown
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.mesh.schemas import ESTOP_ANSWER_S, Execute

from .client import AWAY_S, STOP_S, MeshClient, open_mesh
from .config import MeshConfig
from .mapping_commands import peers, send, send_to_all, stops
from .outcome import UNREACHABLE, Outcome
from .sessions import EVERYBODY, OTHERS

Mesh = MeshConfig | str | os.PathLike[str] | None
"""How to reach robots of other hosts: a configuration, or the path of its file; None: what
``STRANDS_ACTORS_MESH`` names."""

_SET = ("action", "instruction", "clock", "deadline_ns")
OPTIONS = tuple(name for name in Execute.__struct_fields__ if name not in _SET)
"""Of ``tell``."""

_log = logging.getLogger("strands_actors")


def estop(*, mesh: Mesh = None, by: str = "", within_s: float = ESTOP_ANSWER_S) -> list[Outcome]:
    """Every robot on the mesh goes safe, and is locked until it is resumed. What became of each
    that is known, within ``within_s`` (0.25 s at least): safe, unconfirmed or unreachable. ``by``: who
    is told to have stopped them; else this program. Nothing of that, whatever it is, keeps the order
    from leaving: with a ``mesh`` that cannot be used it reaches the robots of this user, and one
    outcome says that others were not looked for. Call it from any thread."""

    async def run() -> list[Outcome]:
        async with open_mesh(mesh, to_stop=True) as client:
            return await client.estop(by, within_s)

    return _estop_from_child(mesh) if forked_from() else portal().call(run)


def _estop_from_child(mesh: Mesh) -> list[Outcome]:
    """In a process that was forked from one that runs robots: by the command line, as no session can
    be opened here."""
    named = ("--mesh", os.fspath(mesh)) if isinstance(mesh, str | os.PathLike) else ()
    told = command_line("estop", *named, within_s=STOP_S)
    if "robots" not in told:
        return [Outcome(EVERYBODY, UNREACHABLE, str(told.get("error")))]
    fields = Outcome.__struct_fields__
    rows = [{key: value for key, value in row.items() if key in fields} for row in told["robots"]]
    outcomes = [msgspec.convert({"outcome": UNREACHABLE, **row}, Outcome) for row in rows]
    if isinstance(mesh, MeshConfig):
        why = "a forked process cannot use a MeshConfig. give the path of its file"
        outcomes.append(Outcome(OTHERS, UNREACHABLE, why))
    return outcomes


def _check_name(verb: str, robot: object) -> None:
    if not isinstance(robot, str):
        raise TypeError(f"{verb}: the robot is {shown(robot)}. give the name of one, as text")


@contextlib.contextmanager
def estop_button(*, mesh: Mesh = None, by: str = "") -> Iterator[Callable[[], list[Outcome]]]:
    """Join the mesh now, for a program that may have to stop at any moment: wait for its robots
    (half a second, if one does not come), and stay. Gives a function that does as ``estop`` does. Call it
    from any thread, as often as need be: the order leaves in that thread, before anything is waited
    for. A ``mesh`` that cannot be used is logged now, and is among the outcomes of each press."""
    joined: Future[MeshClient] = Future()

    async def stay() -> None:
        async with open_mesh(mesh, to_stop=True) as client:
            await client.settle()  # else the first order could leave before anybody is there to hear it
            for lost in client.not_looked_for():
                _log.warning("estop_button: %s: %s", lost.robot, lost.detail)
            joined.set_result(client)
            await trio.sleep_forever()

    staying = portal().submit(stay)
    either: list[Future[Any]] = [joined, staying]
    wait(either, return_when=FIRST_COMPLETED)
    if staying.done():
        staying.result()  # raises why it could not
    client = joined.result()

    def press() -> list[Outcome]:
        if staying.done():
            raise RuntimeError("the button's block has been left. Press it inside, or call estop()")
        pressed = client.press(by)
        time.sleep(AWAY_S)
        return portal().call(client.outcomes, pressed)

    try:
        yield press
    finally:
        staying.cancel()


def get_peers(*, mesh: Mesh = None) -> list[dict[str, Any]]:
    """Return who is on the mesh, within a second and a half: ``peer_id``, ``type``, ``age``,
    ``reachable``, and what each says of itself."""

    async def run() -> list[dict[str, Any]]:
        async with open_mesh(mesh) as client:
            return await peers(client)

    return portal().call(run)


def tell(robot: str, instruction: str, *, mesh: Mesh = None, **options: Any) -> dict[str, Any]:
    """Have a robot of the mesh run a policy that is installed on its host, and wait until that has
    ended; its status then. ``policy_provider`` names it; ``duration``, ``n_steps``,
    ``policy_port``, ``policy_host`` and ``control_frequency`` as ``start_task`` has them. Raise
    ``PermissionError`` with the robot's refusal, ``TypeError`` for what is no name or no option."""
    _check_name("tell", robot)
    for option in options:
        if option not in OPTIONS:
            close = closest(option, OPTIONS)
            hint = f" ({close[0]!r}?)" if close else ""
            raise TypeError(f"tell: there is no option {option!r}{hint}. there are {', '.join(OPTIONS)}")

    async def run() -> dict[str, Any] | Refused:
        async with open_mesh(mesh) as client:
            return await send(client, robot, {"action": "execute", "instruction": instruction, **options})

    answer = portal().call(run)
    if isinstance(answer, Refused):
        raise PermissionError(answer.text)
    return answer


def broadcast(command: Mapping[str, Any] | str, *, mesh: Mesh = None) -> list[dict[str, Any]]:
    """Ask all robots of the mesh for a reading (``"status"``, ``"state"``, ``"ping"``), or stop them
    all. One row a robot: ``responder_id``, and ``result`` or ``error``. Raise ``PermissionError``
    for what is for one robot at a time."""

    async def run() -> dict[str, dict[str, Any] | Refused] | Refused:
        async with open_mesh(mesh, to_stop=stops(command)) as client:
            return await send_to_all(client, command)

    answers = portal().call(run)
    if isinstance(answers, Refused):
        raise PermissionError(answers.text)
    return [
        {"responder_id": name, **({"error": told.text} if isinstance(told, Refused) else {"result": told})}
        for name, told in answers.items()
    ]


def resume(robot: str, *, mesh: Mesh = None, by: str = "") -> None:
    """Lift the lockout of one robot and energise it at the measured position. Raise
    ``PermissionError`` with its refusal, ``TypeError`` for what is no name."""
    _check_name("resume", robot)

    async def run() -> None:
        async with open_mesh(mesh) as client:
            answer = await client.resume(robot, by)
        if isinstance(answer, Refused):
            raise PermissionError(answer.text)

    portal().call(run)

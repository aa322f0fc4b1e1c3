"""The operator gate asks an operator before an agent or another program uses a guarded name.

A name is a verb of the robot's tool, or a key of an action. The robot's own program needs no approval.

These names are guarded: the names in ``Driver.GUARDED``, the names in ``Robot(guarded=...)``, and of a real robot
the verb that energises it, and each service that its driver does not declare for agents.

A name is approved if it is in ``STRANDS_ACTORS_ALLOW``, if its ROS topic is in
``STRANDS_ROS2_COMMAND_ALLOW``, or if ``approve`` returns ``True``. The three are checked in this order. The
name is refused if ``approve`` is missing, does not answer in time, raises, or returns anything else. A stop
needs no approval.
"""

from __future__ import annotations

import select
import termios
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import trio

from strands_actors.contract.agent_verbs import undeclared
from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Driver
from strands_actors.contract.shown import closest, harmless, shown
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.guard import not_approved, unapproved
from strands_actors.kernel.user_code import contained

from .calls import is_motion

MOST_SHOWN = 64
"""Most keys of an action that an operator sees. No robot has more axes."""
APPROVE_S = 30.0
"""Default time for an operator's answer."""

TERMINAL = Path("/dev/tty")

_MOVES, _ENERGISES = ("action", "move_to"), ("torque",)
_VERB_KINDS = {"send_action": _MOVES, "action": _MOVES, "move": _MOVES, "resume": _ENERGISES, "arm": _ENERGISES}
"""Names of the robot's own methods, and the kinds of the matching verbs of the tool. In ``guarded=`` such a
name is refused with a hint, and not replaced by the verbs: these differ between robots, and the user should
know exactly which ones are guarded."""


@dataclass(frozen=True)
class Request:
    """A question to the operator: may this verb run?

    Attributes:
        robot: The name of the robot.
        verb: The verb of the robot's tool, such as ``move_to``.
        inputs: The inputs of the verb, by name.
        by: The program that asks, for example ``agent`` or ``mcp``.
        within_s: Seconds for the operator's answer.
    """

    robot: str
    verb: str
    inputs: Mapping[str, Any] = field(default_factory=dict)
    by: str = "agent"
    within_s: float = field(default=APPROVE_S, compare=False)

    def __str__(self) -> str:
        inputs = " ".join(f"{name}={plainly(value)}" for name, value in self.inputs.items())
        return harmless(f"{self.by} asks {self.robot}: {self.verb} {inputs}".rstrip())


def plainly(value: object) -> str:
    """Return an input as text for the operator. An action is shown with all its keys, because the operator
    approves all of it. Any other long value is cut."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{shown(key)}: {shown(part)}" for key, part in [*value.items()][:MOST_SHOWN]) + "}"
    return shown(value, 200)


Approve = Callable[[Request], bool]


def approval_of(
    driver_class: type[Driver], guarded: Collection[str], approve: Approve | None, within_s: float
) -> Approval:
    """Return the operator gate of a robot, which asks an operator before a guarded name (verb or key of an
    action) is used. It also guards the names in the driver's ``GUARDED``.

    Args:
        driver_class: The driver.
        guarded: Further names to guard.
        approve: Function that asks the operator; None if there is no such function.
        within_s: Seconds for the operator's answer.

    Raises:
        TypeError: An argument has the wrong type, as for ``Approval``.
        ValueError: An argument is wrong, as for ``Approval``, or a guarded name does not exist. If the names
            depend on options of the robot, ``use`` checks them before the first motion of an agent.
    """
    own = Approval(guarded, approve, within_s)
    drivers = _drivers(driver_class) if own.guarded else []
    if drivers and (reason := own.guards_nothing(*drivers)):
        raise ValueError(reason)
    return Approval(own.guarded | set(driver_class.GUARDED), approve, within_s, driver_class.TOPICS)


def _drivers(driver_class: type[Driver]) -> list[Driver]:
    """Return a driver for each type of robot that a driver class supports. Return an empty list if the drivers
    cannot be built without further options."""
    try:
        return [driver_class(robot, "", driver_class.resolve(robot, {})) for robot in driver_class.SUPPORTED_ROBOTS]
    except (ValueError, TypeError):
        return []


def _guardable(driver: Driver) -> tuple[str, ...]:
    """Return the names that can be guarded: verbs that move the robot or switch its motors' power, the robot's
    axes, and its services without a verb. Reading and stopping cannot be guarded."""
    services = {name: is_motion(service) for name, service in driver.SERVICES.items()}
    verbs = {verb.name: verb.does for verb in driver.TOOL_VERBS}
    moving = [
        name
        for name, does in verbs.items()
        if does in ("action", "move_to", "torque") or (services.get(name) and does == "service")
    ]
    others = undeclared(driver)
    return tuple(dict.fromkeys((*moving, *driver.GUARDED, *others, *driver.axes)))


class Approval:
    """The operator gate of one robot, which asks an operator before a guarded name is used.

    Args:
        guarded: Names that need an approval: verbs, and keys of an action.
        approve: Function that asks the operator about a request. It runs in a separate thread, and only
            ``True`` approves. If it is None, a guarded request is refused unless an environment variable such
            as ``STRANDS_ACTORS_ALLOW`` lists its names.
        within_s: Seconds for the operator's answer.
        topics: The ROS topic of each guarded name that has one.

    Raises:
        TypeError: An argument has the wrong type.
        ValueError: ``guarded`` names ``stop``, or ``within_s`` is not above 0.
    """

    def __init__(
        self,
        guarded: Collection[str] = (),
        approve: Approve | None = None,
        within_s: float = APPROVE_S,
        topics: Mapping[str, str] | None = None,
    ) -> None:
        if isinstance(guarded, str):
            raise TypeError(f"guarded is {guarded!r}. Give a tuple of verbs and action keys: ({guarded!r},)")
        if not isinstance(guarded, Collection) or not all(isinstance(name, str) for name in guarded):
            raise TypeError(f"guarded is {shown(guarded)}. Give a tuple of verbs and action keys: ('move_to',)")
        if "stop" in guarded:
            raise ValueError("guarded names stop, and a stop needs no approval. Leave it out")
        if approve is not None and not callable(approve):
            raise TypeError(
                f"approve is {approve!r}. Give a function that takes a request and returns True or False"
            )
        seconds = finite(within_s)
        if seconds is None or seconds <= 0:
            raise ValueError(f"approve_within_s is {shown(within_s)}. Give seconds, a number above 0")
        self.guarded = frozenset(name.removesuffix(".pos") for name in guarded)
        self._topics = dict(topics or {})
        self._approve = approve
        self._within_s = seconds

    def guards_nothing(self, *drivers: Driver) -> str:
        """Return an error text if a guarded name fits no verb, axis or service of these robots. The text lists
        the names that fit, and is empty if all guarded names fit."""
        of_each = [_guardable(driver) for driver in drivers]
        guardable = list(dict.fromkeys(name for names in of_each for name in names))
        wrong = sorted(self.guarded.difference(guardable))
        if not wrong:
            return ""
        name, verbs = wrong[0], [verb for driver in drivers for verb in driver.TOOL_VERBS]
        if any(verb.name == name and verb.does == "stop" for verb in verbs):
            return f"guarded names {name}, which is a stop and needs no approval. Leave it out"
        suggestions = {verb.name for verb in verbs if verb.does in _VERB_KINDS.get(name, ())} or closest(
            name, guardable
        )
        hint = f" (do you mean {' or '.join(sorted(suggestions))}?)" if suggestions else ""
        common = [each for each in guardable if all(each in names for names in of_each)]
        listed = ", ".join(common) + (", and the axes of the robot" if len(common) < len(guardable) else "")
        return f"guarded names {shown(name)}, which guards nothing here{hint}. There are {listed or 'none'}"

    async def refuse(
        self, request: Request, keys: Iterable[str] = (), needs_approval: bool = False
    ) -> Refused | None:
        """Return a refusal, or None if the request needs no approval or is approved.

        Args:
            request: The request.
            keys: Keys of the action (command to the robot's axes) that the request would send.
            needs_approval: True guards the verb, even if ``guarded`` does not name it.
        """
        guarded = self.guarded | {request.verb} if needs_approval else self.guarded
        names = unapproved(guarded, (request.verb, *keys), self._topics)
        reason = await self._ask(request) if names else None
        return None if reason is None else not_approved(names, reason).about(request.verb)

    async def _ask(self, request: Request) -> str | None:
        """Ask the operator. Return None for an approval, otherwise the reason for the refusal."""
        if self._approve is None:
            return "no operator can be asked"
        timed = replace(request, within_s=self._within_s)
        with trio.move_on_after(self._within_s):
            try:
                answer = await trio.to_thread.run_sync(contained, self._approve, timed, abandon_on_cancel=True)
            except Exception as error:  # The ``approve`` function may raise anything. An exception is a refusal.
                return f"asking failed with {type(error).__name__}: {error}"
            return None if answer is True else "it was not given"
        return f"no answer within {self._within_s:g} s"


def ask_on_terminal(request: Request) -> bool:
    """Ask for an approval on the controlling terminal, even if input and output are redirected.

    The prompt gives up before ``APPROVE_S``, so that a late yes does not answer the next prompt.

    Raises:
        OSError: There is no terminal.
    """
    with TERMINAL.open("r+b", buffering=0) as terminal:
        termios.tcflush(terminal, termios.TCIFLUSH)
        terminal.write(f"\n{request}. allow? [y/N] ".encode())
        ready, _, _ = select.select([terminal], [], [], 0.9 * APPROVE_S)
        return bool(ready) and terminal.readline().strip().lower() in (b"y", b"yes")

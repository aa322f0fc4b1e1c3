"""The operator gate: an agent or another program may use a guarded verb or key only with an operator's
approval. The robot's own program needs no approval.

Guarded are the names in ``Driver.GUARDED``, those that ``Robot(guarded=...)`` adds (verbs, and keys of an
action), and each service of a real robot that its driver does not declare for agents.

A name is approved if it is in ``STRANDS_ACTORS_ALLOW``, if its ROS topic is in
``STRANDS_ROS2_COMMAND_ALLOW``, or if ``approve`` returns ``True``; they are checked in this order. It is
refused if there is no ``approve``, no answer in time, an exception, or any other answer. A stop needs no
approval.
"""

from __future__ import annotations

import select
import termios
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
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
_MEANT = {"send_action": _MOVES, "action": _MOVES, "move": _MOVES, "resume": _ENERGISES, "arm": _ENERGISES}
"""Names of the robot's own methods, and the kinds of the matching verbs of the tool. In ``guarded=`` such a
name is refused with a hint, and not replaced by the verbs: these differ between robots, and the user should
know exactly which ones are guarded."""


@dataclass(frozen=True)
class Request:
    """A request to the operator.

    Attributes:
        robot: The name of the robot.
        verb: The verb.
        inputs: The inputs of the verb.
        by: The caller.
    """

    robot: str
    verb: str
    inputs: Mapping[str, Any] = field(default_factory=dict)
    by: str = "agent"

    def __str__(self) -> str:
        inputs = " ".join(f"{name}={_plainly(value)}" for name, value in self.inputs.items())
        return harmless(f"{self.by} asks {self.robot}: {self.verb} {inputs}".rstrip())


def _plainly(value: object) -> str:
    """Return a value as text. An action is shown whole, so that an operator approves nothing unseen. Other
    values are cut where they become unreadable."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{shown(key)}: {shown(part)}" for key, part in [*value.items()][:MOST_SHOWN]) + "}"
    return shown(value, 200)


Approve = Callable[[Request], bool]


def approval_of(
    driver_class: type[Driver], guarded: Collection[str], approve: Approve | None, within_s: float
) -> Approval:
    """Return the operator gate of a robot, with the names that its driver guards.

    Args:
        driver_class: The driver.
        guarded: Further names to guard.
        approve: Asks the operator.
        within_s: Seconds for the operator's answer.

    Raises:
        TypeError: As for ``Approval``.
        ValueError: As for ``Approval``, and for a name that would guard nothing. If that cannot be checked
            before the robot is known, an agent's motion is refused later.
    """
    own = Approval(guarded, approve, within_s)
    drivers = _drivers(driver_class) if own.guarded else []
    if drivers and (why := own.guards_nothing(*drivers)):
        raise ValueError(why)
    return Approval(own.guarded | set(driver_class.GUARDED), approve, within_s, driver_class.TOPICS)


def _drivers(driver_class: type[Driver]) -> list[Driver]:
    """Return a driver for each robot of a class; an empty list if they need further options."""
    try:
        return [driver_class(robot, "", driver_class.resolve(robot, {})) for robot in driver_class.SUPPORTED_ROBOTS]
    except (ValueError, TypeError):
        return []


def _guardable(driver: Driver) -> tuple[str, ...]:
    """Return the names that can be guarded: verbs that move the robot or switch its power, its axes, and
    its own services. Reading and stopping cannot be guarded."""
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
    """The operator gate of one robot.

    Args:
        guarded: Names that need an approval: verbs, and keys of an action.
        approve: Asks the operator about a request, in a separate thread. Only ``True`` approves. Without
            it, guarded requests are refused unless the environment allows them.
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
            raise TypeError(f"guarded is {guarded!r}. give a tuple of verbs and action keys: ({guarded!r},)")
        if not isinstance(guarded, Collection) or not all(isinstance(name, str) for name in guarded):
            raise TypeError(f"guarded is {shown(guarded)}. give a tuple of verbs and action keys: ('move_to',)")
        if "stop" in guarded:
            raise ValueError("guarded names stop. a stop is never asked about")
        if approve is not None and not callable(approve):
            raise TypeError(
                f"approve is {approve!r}. give a function that takes a request and returns True or False"
            )
        seconds = finite(within_s)
        if seconds is None or seconds <= 0:
            raise ValueError(f"approve_within_s is {shown(within_s)}. give seconds, a number above 0")
        self.guarded = frozenset(name.removesuffix(".pos") for name in guarded)
        self._topics = dict(topics or {})
        self._approve = approve
        self._within_s = seconds

    def guards_nothing(self, *drivers: Driver) -> str:
        """Return an error text if a guarded name fits no verb, axis or service of these robots. It lists the
        names that fit. Empty if all names fit."""
        of_each = [_guardable(driver) for driver in drivers]
        guardable = list(dict.fromkeys(name for names in of_each for name in names))
        wrong = sorted(self.guarded.difference(guardable))
        if not wrong:
            return ""
        name, verbs = wrong[0], [verb for driver in drivers for verb in driver.TOOL_VERBS]
        if any(verb.name == name and verb.does == "stop" for verb in verbs):
            return f"guarded names {name}, which is a stop. a stop is never asked about"
        meant = {verb.name for verb in verbs if verb.does in _MEANT.get(name, ())} or closest(name, guardable)
        hint = f" (do you mean {' or '.join(sorted(meant))}?)" if meant else ""
        common = [each for each in guardable if all(each in names for names in of_each)]
        listed = ", ".join(common) + (", and the axes of the robot" if len(common) < len(guardable) else "")
        return f"guarded names {shown(name)}, which guards nothing here{hint}. there are {listed or 'none'}"

    async def refuse(self, request: Request, keys: Iterable[str] = (), asks: bool = False) -> Refused | None:
        """Return a refusal; None if the request needs no approval or has it.

        Args:
            request: The request.
            keys: Keys of the action to which it leads.
            asks: The verb is guarded, even if ``guarded`` does not name it.
        """
        guarded = self.guarded | {request.verb} if asks else self.guarded
        names = unapproved(guarded, (request.verb, *keys), self._topics)
        why = await self._ask(request) if names else None
        return None if why is None else not_approved(names, why).about(request.verb)

    async def _ask(self, request: Request) -> str | None:
        """Return why the request is not approved; None if it is."""
        if self._approve is None:
            return "there is nobody to ask"
        with trio.move_on_after(self._within_s):
            try:
                answer = await trio.to_thread.run_sync(contained, self._approve, request, abandon_on_cancel=True)
            except Exception as error:  # The operator's code may raise anything, which is not an approval.
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

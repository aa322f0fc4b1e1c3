"""The operator gate: who is not the robot's own program may use what is guarded only when a person
agrees.

Guarded is what a driver declares (``Driver.GUARDED``), what ``Robot(guarded=...)`` adds (verbs, and
keys of an action), and each service of a real robot that its driver does not declare for agents.
Agreement is, in this order, the name in ``STRANDS_ACTORS_ALLOW``, its ROS topic in
``STRANDS_ROS2_COMMAND_ALLOW``, or the answer ``True`` of ``approve``. No answer in time, an exception,
any other answer, or nobody to ask: refused. Whoever asks to stop is not asked.
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
"""Keys of an action that an operator is shown; no robot has more axes."""
APPROVE_S = 30.0
"""How long an operator may think."""

TERMINAL = Path("/dev/tty")

_MOVES, _ENERGISES = ("action", "move_to"), ("torque",)
_MEANT = {"send_action": _MOVES, "action": _MOVES, "move": _MOVES, "resume": _ENERGISES, "arm": _ENERGISES}
"""What the robot's own program calls what an agent asks for by another name. They are refused, not
taken for it: which verbs an action comes by differs from robot to robot, and who names one should
know what is guarded."""


@dataclass(frozen=True)
class Request:
    """What is asked for."""

    robot: str
    verb: str
    inputs: Mapping[str, Any] = field(default_factory=dict)
    by: str = "agent"

    def __str__(self) -> str:
        inputs = " ".join(f"{name}={_plainly(value)}" for name, value in self.inputs.items())
        return harmless(f"{self.by} asks {self.robot}: {self.verb} {inputs}".rstrip())


def _plainly(value: object) -> str:
    """Return all of an action, so that nobody agrees to what is not shown; cut where nothing could
    be read."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{shown(key)}: {shown(part)}" for key, part in [*value.items()][:MOST_SHOWN]) + "}"
    return shown(value, 200)


Approve = Callable[[Request], bool]


def approval_of(
    driver_class: type[Driver], guarded: Collection[str], approve: Approve | None, within_s: float
) -> Approval:
    """With what the driver guards by itself. Raise as ``Approval``, and ``ValueError`` for a name
    that would guard nothing, where that can be known before the robot is: else an agent's motion is
    refused for it."""
    own = Approval(guarded, approve, within_s)
    drivers = _drivers(driver_class) if own.guarded else []
    if drivers and (why := own.guards_nothing(*drivers)):
        raise ValueError(why)
    return Approval(own.guarded | set(driver_class.GUARDED), approve, within_s, driver_class.TOPICS)


def _drivers(driver_class: type[Driver]) -> list[Driver]:
    """Return one for each robot it is for; none where they cannot be made without their options."""
    try:
        return [driver_class(robot, "", driver_class.resolve(robot, {})) for robot in driver_class.SUPPORTED_ROBOTS]
    except (ValueError, TypeError):
        return []


def _guardable(driver: Driver) -> tuple[str, ...]:
    """Return what an operator can be asked about: verbs that move the robot or give and take its
    power, its axes and its own services. Nobody is asked before what only reads, or stops."""
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
    """The gate of one robot. ``within_s``: how long ``approve`` may take; it runs in a thread of
    its own."""

    def __init__(
        self,
        guarded: Collection[str] = (),
        approve: Approve | None = None,
        within_s: float = APPROVE_S,
        topics: Mapping[str, str] | None = None,
    ) -> None:
        """Raise ``TypeError`` or ``ValueError`` for what would guard nothing, or nothing that can
        be."""
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
        """Return which name is none of what one of these robots can be asked for, and what is;
        empty: all are."""
        of_each = [_guardable(driver) for driver in drivers]
        known = list(dict.fromkeys(name for names in of_each for name in names))
        wrong = sorted(self.guarded.difference(known))
        if not wrong:
            return ""
        name, verbs = wrong[0], [verb for driver in drivers for verb in driver.TOOL_VERBS]
        if any(verb.name == name and verb.does == "stop" for verb in verbs):
            return f"guarded names {name}, which is a stop. a stop is never asked about"
        meant = {verb.name for verb in verbs if verb.does in _MEANT.get(name, ())} or closest(name, known)
        hint = f" (do you mean {' or '.join(sorted(meant))}?)" if meant else ""
        common = [each for each in known if all(each in names for names in of_each)]
        there = ", ".join(common) + (", and the axes of the robot" if len(common) < len(known) else "")
        return f"guarded names {shown(name)}, which guards nothing here{hint}. there are {there or 'none'}"

    async def refuse(self, request: Request, keys: Iterable[str] = (), asks: bool = False) -> Refused | None:
        """None: go on. ``keys``: of the action it would come to. ``asks``: the verb is guarded, whoever
        has named it or not."""
        guarded = self.guarded | {request.verb} if asks else self.guarded
        names = unapproved(guarded, (request.verb, *keys), self._topics)
        why = await self._ask(request) if names else None
        return None if why is None else not_approved(names, why).about(request.verb)

    async def _ask(self, request: Request) -> str | None:
        """None: approved."""
        if self._approve is None:
            return "there is nobody to ask"
        with trio.move_on_after(self._within_s):
            try:
                answer = await trio.to_thread.run_sync(contained, self._approve, request, abandon_on_cancel=True)
            except Exception as error:  # the operator's code may raise anything, which is no yes
                return f"asking failed with {type(error).__name__}: {error}"
            return None if answer is True else "it was not given"
        return f"no answer within {self._within_s:g} s"


def ask_on_terminal(request: Request) -> bool:
    """A prompt on the terminal that the command was started from, wherever its input and output go.
    Raise ``OSError`` when there is none. It gives up before ``APPROVE_S``: a late yes must not
    answer the next prompt."""
    with TERMINAL.open("r+b", buffering=0) as terminal:
        termios.tcflush(terminal, termios.TCIFLUSH)
        terminal.write(f"\n{request}. allow? [y/N] ".encode())
        ready, _, _ = select.select([terminal], [], [], 0.9 * APPROVE_S)
        return bool(ready) and terminal.readline().strip().lower() in (b"y", b"yes")

"""The operator gate: who is not the robot's own program may use what is guarded only when a person
agrees.

Guarded is what a driver declares (``Driver.GUARDED``) and what ``Robot(guarded=...)`` adds: verbs,
and keys of an action. Agreement is, in this order, the name in ``STRANDS_ACTORS_ALLOW``, its ROS
topic in ``STRANDS_ROS2_COMMAND_ALLOW``, or the answer ``True`` of ``approve``. No answer in time,
an exception, any other answer, or nobody to ask: refused. Whoever asks to stop is not asked.
"""

from __future__ import annotations

import select
import termios
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.shown import harmless, shown
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.guard import not_approved, unapproved

MOST_SHOWN = 64
"""Keys of an action that an operator is shown; no robot has more axes."""
APPROVE_S = 30.0
"""How long an operator may think."""

TERMINAL = Path("/dev/tty")


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
    """With what the driver guards by itself."""
    own = Approval(guarded, approve, within_s)
    return Approval(own.guarded | set(driver_class.GUARDED), approve, within_s, driver_class.TOPICS)


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
        if "stop" in guarded:
            raise ValueError("guarded names stop. a stop is never asked about")
        if approve is not None and not callable(approve):
            raise TypeError(
                f"approve is {approve!r}. give a function that takes a request and returns True or False"
            )
        self.guarded = frozenset(guarded)
        self._topics = dict(topics or {})
        self._approve = approve
        self._within_s = within_s

    async def refuse(self, request: Request, keys: Iterable[str] = ()) -> Refused | None:
        """None: go on. ``keys``: of the action it would come to."""
        names = unapproved(self.guarded, (request.verb, *keys), self._topics)
        why = await self._ask(request) if names else None
        return None if why is None else not_approved(request.verb, names, why)

    async def _ask(self, request: Request) -> str | None:
        """None: approved."""
        if self._approve is None:
            return "there is nobody to ask"
        with trio.move_on_after(self._within_s):
            try:
                answer = await trio.to_thread.run_sync(self._approve, request, abandon_on_cancel=True)
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

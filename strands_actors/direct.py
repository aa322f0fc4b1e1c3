"""Commands by the thread that gives them: it asks the gate itself, past the loop of its process.

That is the way of nearly every ``send_action`` of a script, and saves it the waking of a second thread, there and
back (``runtime/thread_line.py`` has figures). It decides nothing. Where there is anything to decide, since a
rollout runs, the lease is not or no longer good, another thread asks just now or there is no line, the command goes
by the loop, where ``RobotTree`` has all of that in one place: every verb here answers None then, and nothing was
written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from .portal import portal
from .runtime.contract import Observation
from .runtime.messages import Message, Refused
from .runtime.node import AskTimeout, Unreachable
from .runtime.thread_line import NotSent
from .supervisors.actions import refuse_shape
from .supervisors.messages import Accepted, GetObservation, Lease, Performed
from .tree_processes import ASK_S, TreeProcesses, unreachable
from .writer import STALE, Writer

if TYPE_CHECKING:
    from .tree import RobotTree


class Direct:
    """All methods are of any thread but the loop's, which they would hold up."""

    def __init__(self, tree: RobotTree, processes: TreeProcesses, writer: Writer) -> None:
        self._tree = tree
        self._processes = processes
        self._writer = writer

    def send_action(self, action: Mapping[str, Any]) -> Accepted | Refused | None:
        if refuse_shape(action) is not None:
            return None
        answer = self._command("move", lambda lease: self._tree.setpoint(lease, action), ASK_S)
        return answer if isinstance(answer, Accepted | Refused) else None

    def perform(
        self, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None
    ) -> Performed | Refused | None:
        tree = self._tree
        if tree.refuse_service(service, arguments, action) is not None:
            return None
        answer = self._command(
            service, lambda lease: tree.performing(lease, service, arguments, action), tree.within_s(service)
        )
        return answer if isinstance(answer, Performed | Refused) else None

    def observe(self) -> Observation | Refused | None:
        line = self._processes.thread_line
        if line is None:
            return None
        try:
            answer = line.ask(GetObservation(), ASK_S)
        except (NotSent, AskTimeout, Unreachable):
            return None
        return answer if isinstance(answer, Observation | Refused) else None

    def _command(self, verb: str, make: Callable[[Lease], Message], within_s: float) -> Message | None:
        line, lease = self._processes.thread_line, self._writer.lease
        if line is None or lease is None or self._tree.rollouts.running:
            return None
        try:
            answer = line.ask(make(lease), within_s)
        except NotSent:
            return None
        except AskTimeout as timeout:
            return portal().call(self._tree.late, verb, timeout)
        except Unreachable as failure:
            return unreachable(verb, failure)
        return None if isinstance(answer, Refused) and answer.code in STALE else answer

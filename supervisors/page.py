"""The page of memory that root, wire and standby of one robot share, and what stands where on
it.

Whether something may be energised stands here because the standby can ask nobody: a wire that is
killed while it makes safe leaves a standby that acts; one that has made safe, a standby that ends.
Which safe state was ordered stands here because another process may have to bring it about than the
one that was asked.
"""

from __future__ import annotations

from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.health.heartbeat import Word, private_page

ROOT, WIRE, STANDBY = range(3)
"""Places of heartbeats."""
_OWED, _SILENT, _ORDERED, _STOPPED, _WIRE_PID = 3, 4, 5, 6, 7
_BY_SEVERITY = tuple(SafeState)


class Owed:
    """What the standby must know of a wire that can no longer be asked."""

    def __init__(self, words: memoryview | None = None) -> None:
        """None: nobody shares it."""
        page = private_page() if words is None else words
        self._owed = Word(page, _OWED)
        self._silent = Word(page, _SILENT)
        self._ordered = Word(page, _ORDERED)  # a severity; 0: nothing, or the mildest
        self._stopped = Word(page, _STOPPED)
        self._wire_pid = Word(page, _WIRE_PID)

    @property
    def safe_state(self) -> bool:
        """Return whether something may be energised: from before arming until every motor has
        confirmed the safe state of a stop. Written by the wire, and by the root once that has made
        safe in its place."""
        return self._owed.get() != 0

    @safe_state.setter
    def safe_state(self, owed: bool) -> None:
        self._owed.set(int(owed))

    @property
    def silent_until_ns(self) -> int:
        """The wire may not beat until then: an SDK keeps the interpreter's lock."""
        return self._silent.get()

    @silent_until_ns.setter
    def silent_until_ns(self, until_ns: int) -> None:
        self._silent.set(until_ns)

    @property
    def stopped_ns(self) -> int:
        """When the root was last told to stop the robot: a wire that begins has to know. 0: never."""
        return self._stopped.get()

    @stopped_ns.setter
    def stopped_ns(self, at_ns: int) -> None:
        self._stopped.set(at_ns)

    @property
    def wire_pid(self) -> int:
        """The wire process that was started last; 0: none, or it had ended when the root looked. Written
        by the root, which may end before it has told the standby of a new one."""
        return self._wire_pid.get()

    @wire_pid.setter
    def wire_pid(self, pid: int) -> None:
        self._wire_pid.set(pid)

    def order(self, safe_state: SafeState, lasts: bool = True) -> SafeState:
        """Note an order to make safe, if it ``lasts`` until it is confirmed. Return where to bring the
        robot: there, or to a more severe state that was ordered before and not confirmed since. An
        e-stop whose link is lost, or whose wire is frozen, is not answered by the milder state that
        such a fault leads to."""
        wanted = SafeState(safe_state).or_more(_BY_SEVERITY[self._ordered.get()])
        if lasts:
            self._ordered.set(wanted.severity)
        return wanted

    def confirm(self, safe_state: SafeState) -> None:
        """Note that every motor has confirmed it."""
        if SafeState(safe_state).severity >= self._ordered.get():
            self.begin_anew()

    def begin_anew(self) -> None:
        """Forget what was ordered: it is confirmed, or the robot is armed by a later order."""
        self._ordered.set(0)

"""The page of memory that root, wire and standby of one robot share, and what stands where on
it.

Whether something may be energised stands here because the standby can ask nobody: a wire that is
killed while it makes safe leaves a standby that acts; one that has made safe, a standby that ends.
Which safe state was ordered stands here because another process may have to bring it about than the
one that was asked. So does what the wire has asked of the robot and the robot has not yet answered:
it may take effect after the wire's death, and after a safe frame that another process wrote.
"""

from __future__ import annotations

from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health.heartbeat import Word, private_page

ROOT, WIRE, STANDBY = range(3)
"""Places of heartbeats."""
_OWED, _SILENT, _ORDERED, _STOPPED, _WIRE_PID, _LATE = 3, 4, 5, 6, 7, 8
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
        # Negative: a request is under way that may take effect so long after it is cut off.
        # Positive: one was cut off, and may take effect until then. 0: neither.
        self._late = Word(page, _LATE)

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

    # -- requests that may take effect after a stop

    @property
    def is_asking(self) -> bool:
        """Return whether the wire process has a request under way that may take effect later."""
        return self._late.get() < 0

    def ask(self, late_ns: int) -> None:
        """Note that a request is under way.

        Args:
            late_ns: How long it may still take effect after it is cut off.
        """
        self._late.set(-late_ns)

    def settle_at(self, until_ns: int) -> None:
        """Note that no request is under way, and until when an earlier one may take effect."""
        self._late.set(until_ns)

    def cut_off(self, now_ns: int) -> None:
        """Note that the wire process has ended, and with it a request that was under way."""
        late = self._late.get()
        if late < 0:
            self._late.set(now_ns - late)

    def unsettled_s(self, now_ns: int) -> float:
        """Return for how long something that was asked for may still take effect.

        A safe state counts as confirmed only if the attempt that confirms it began when this was 0.
        """
        late = self._late.get()
        return -late / NS if late < 0 else max(0.0, (late - now_ns) / NS)

    # -- what was ordered

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

"""Command the parts of a robot through their gates.

This wire reaches no hardware. It is the only writer of each part, and holds the lease of each. A setpoint is
checked twice. The gate of the robot runs the checks of all parts before anything is sent. The gate of each part
checks it again, as that of any writer.

A part whose epoch has changed without an order of this wire has stopped or held by itself. The other parts are then
stopped, or hold, at once. If this process ends or freezes, each part sees that its writer is lost, and goes to the
safe state that its own table declares for that.
"""

from __future__ import annotations

import itertools
import os
from typing import Any, ClassVar

import trio

from strands_actors.contract.axis import finite
from strands_actors.contract.driver import HOLDING_REASONS, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, Wire, WireDown
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.supervisors.gate.failsafe import LINKED, WRITABLE
from strands_actors.supervisors.gate.messages import (
    Accepted,
    Acquire,
    Beat,
    GetStatus,
    Lease,
    Resume,
    Resumed,
    Setpoint,
    Status,
)
from strands_actors.supervisors.root.messages import AttachProgram, Hosted
from strands_actors.supervisors.root.process import Root

from .config import HELD, PART_STATE, STOPPED, WRITE_S, PartConfig, PartsConfig, ordered
from .links import Links

LOOK_S = 0.02
"""Period at which each part is asked for its state."""
ASK_S = 0.5
"""Longest wait for an answer of a part, except to a stop. The end of its wire process is noticed at once."""
BEAT_S = 0.04
WRITE_NS = 250_000_000
"""Longest time from the write of a setpoint without an end to its write by the part."""


_leases: dict[str, Lease] = {}
"""The lease of this process for each part, by the part's name among the robots that run. A connection that is
opened again continues with it, since the part gives it to no other writer."""


class _Part:
    """What this wire knows of one part.

    Attributes:
        config: The part.
        status: Its newest status.
        epoch: Its epoch after the last order of this wire. Another epoch means that it has stopped or held by
            itself.
        odd: Why it no longer follows the other parts, although it has not stopped. It has refused a setpoint.
    """

    def __init__(self, config: PartConfig) -> None:
        self.config = config
        self.status: Status | None = None
        self.epoch = 0
        self.odd = ""

    @property
    def lease(self) -> Lease | None:
        """The right to command the part; None before the robot was armed."""
        return _leases.get(self.config.robot)

    @property
    def state(self) -> float:
        status = self.status
        if self.odd:
            return HELD
        if status is None or status.epoch <= self.epoch:
            return 0.0
        return HELD if status.mode in WRITABLE else STOPPED

    @property
    def cause(self) -> str:
        return self.odd or (self.status.cause if self.status is not None else "")


class PartsWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: PartsConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._links = Links(config)
        self._parts = {part.name: _Part(part) for part in config.parts}
        self._scope = trio.CancelScope()
        self._down = ""
        # True while an order of this wire changes the epochs of the parts.
        self._is_ordering = False

    # -- the connections

    async def open(self) -> dict[str, Any]:
        opened = trio.Event()
        trio.lowlevel.spawn_system_task(self._run, opened)
        await opened.wait()
        self._fail_if_down()
        await self._links.each(self._join)
        self._fail_if_down()
        return {"parts": [part.robot for part in self._config.parts]}

    async def _run(self, opened: trio.Event) -> None:
        """Keep the connections and the leases. A task of the system runs this, since it has to outlive ``serve``:
        after a lost part, the others are stopped over the same connections."""
        try:
            with self._scope:
                async with trio.open_nursery() as nursery:
                    await nursery.start(self._links.run)
                    nursery.start_soon(self._beat)
                    opened.set()
        except Exception as error:
            self._down = f"the connection to the parts failed: {error}"
        opened.set()

    async def _join(self, part: PartConfig) -> None:
        """Wait until a part is connected to its hardware and guarded, and attach this process to it."""
        problem = "it does not answer"
        while True:
            try:
                answer = await self._links.ask(part, GetStatus(), ASK_S)
                if isinstance(answer, Status):
                    problem = answer.connect_error or answer.no_standby
                    if answer.mode in LINKED and answer.observation is not None and not answer.no_standby:
                        await self._attach(part, answer)
                        return
                    if answer.connect_error and answer.connect_error != "not connected yet":
                        self._down = f"{part.name}: {problem}"
                        return
            except (AskTimeout, Unreachable) as failure:
                problem = str(failure)
            await trio.sleep(LOOK_S)

    async def _attach(self, part: PartConfig, status: Status) -> None:
        answer = await self._links.ask(part, AttachProgram(os.getpid()), ASK_S, Root)
        if not isinstance(answer, Hosted):
            self._down = f"{part.name}: its root process does not let this robot command it"
        member = self._parts[part.name]
        member.status, member.epoch, member.odd = status, status.epoch, ""

    async def _beat(self) -> None:
        while True:
            await trio.sleep(BEAT_S)
            for part in self._parts.values():
                if part.lease is not None:
                    self._links.tell(part.config, Beat(part.lease.id))

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        async with trio.open_nursery() as nursery:
            for part in self._parts.values():
                nursery.start_soon(self._watch, part)
            task_status.started()

    async def _watch(self, part: _Part) -> None:
        """Ask a part for its state, again and again. If it has stopped by itself, stop the others at once."""
        while not self._down:
            await trio.sleep(LOOK_S)
            answer: Message | None = None
            try:
                answer = await self._links.ask(part.config, GetStatus(), ASK_S)
            except Unreachable as failure:
                self._down = f"{part.config.name}: {failure}"
            except AskTimeout:
                # The computer may be busy. A part whose wire process is frozen is stopped by its own root process,
                # which ends that process, so that the next question finds nothing.
                pass
            if isinstance(answer, Status):
                part.status = answer
                if not answer.connected:
                    self._down = f"{part.config.name}: {answer.connect_error}"
            if self._is_ordering:
                continue
            if self._down:
                await self._stop_others(part, Reason.LINK)
            elif part.state == STOPPED:
                await self._stop_others(part, Reason.FAULT)

    async def _stop_others(self, lost: _Part, reason: Reason) -> None:
        """Stop the other parts before the gate of the robot orders it, which comes at most one period later."""
        for part in self._parts.values():
            if part is not lost and part.status is not None and part.status.mode in WRITABLE:
                await self._order(part, reason, False, False, f"{lost.config.name} stopped")

    def _fail_if_down(self) -> None:
        if self._down:
            raise WireDown(self._down)

    # -- orders

    async def arm(self, permit: Permit) -> Observation:
        self._fail_if_down()
        permit.check()
        requested_ns = self._clock.now_ns()
        self._is_ordering = True
        try:

            async def arm(part: PartConfig) -> str:
                return await self._arm(self._parts[part.name], requested_ns)

            problems = [problem for problem in await self._links.each(arm) if problem]
        finally:
            self._is_ordering = False
        if problems:
            raise WireDown(". ".join(problems))
        return self._merged()

    async def _arm(self, part: _Part, requested_ns: int) -> str:
        """Arm one part and take its lease. Return why that failed; empty if it did not.

        A request that arrives after a stop is refused by the part, since it has the time of the request.
        """
        config = part.config
        resume = Resume(self._config.robot, self.lifts, requested_ns)
        again = part.lease.id if part.lease is not None else 0
        acquire = Acquire(f"{self._config.robot} (all its parts)", pid=os.getpid(), again=again)
        try:
            answer = await self._links.ask(config, resume, config.timing.arm_s + ASK_S)
            if not isinstance(answer, Resumed):
                return f"{config.name}: {_text(answer)}"
            lease = await self._links.ask(config, acquire, config.timing.safe_s + ASK_S)
            if not isinstance(lease, Lease):
                return f"{config.name}: {_text(lease)}"
            await self._refresh(part)
        except (AskTimeout, Unreachable) as failure:
            return f"{config.name}: {failure}"
        _leases[config.robot] = lease
        return ""

    async def _refresh(self, part: _Part) -> None:
        """Read the state of a part after an order. Its epoch is then the one that this order led to."""
        answer = await self._links.ask(part.config, GetStatus(), ASK_S)
        if isinstance(answer, Status):
            part.status, part.epoch, part.odd = answer, answer.epoch, ""

    async def read(self) -> Observation:
        self._fail_if_down()
        return self._merged()

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        self._fail_if_down()
        now_ns = self._clock.now_ns()
        deadline_ns = self.expires_ns or now_ns + WRITE_NS
        permit.check()

        async def send(part: PartConfig) -> str:
            member = self._parts[part.name]
            if member.lease is None:
                return "it has no lease"
            action: dict[str, Any] = {
                key: value
                for key, value in zip(part.keys, values[part.span], strict=True)
                if finite(value) is not None
            }
            period_s = 1.0 / part.timing.control_hz if self.streamed else 0.0
            latched = not self.expires_ns
            setpoint = Setpoint(member.lease.id, member.epoch, deadline_ns, action, period_s, latched)
            try:
                answer = await self._links.ask(part, setpoint, WRITE_S)
            except (AskTimeout, Unreachable) as failure:
                return str(failure)
            return "" if isinstance(answer, Accepted) else _text(answer)

        problems = dict(zip(self._parts, await self._links.each(send), strict=True))
        refused = {name: problem for name, problem in problems.items() if problem}
        if not refused:
            return
        # The others have taken it: they hold, at once. The gate of the robot then orders a hold of all parts.
        for name, problem in refused.items():
            self._parts[name].odd = f"{name} did not take a setpoint: {problem}"
        await self._each_ordered(Reason.EXPIRED, True, "a part did not take a setpoint", keep_odd=True)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        reason = Reason(self.reason) if self.reason else self._config.reason_for(safe_state)
        holds = reason in HOLDING_REASONS and any(safe_state in part.energised for part in self._config.parts)
        return await self._each_ordered(reason, holds, self._config.robot)

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the parts over the connections that are still open. Without any, a new stop channel is used."""
        return await self.make_safe(safe_state) if self._links.are_open else ()

    async def _each_ordered(
        self, reason: Reason, holds: bool, by: str, keep_odd: bool = False
    ) -> tuple[MotorReport, ...]:
        self._is_ordering = True
        lock = reason is Reason.ESTOP
        try:

            async def order(part: PartConfig) -> tuple[MotorReport, ...]:
                member = self._parts[part.name]
                odd = member.odd
                reports = await self._order(member, reason, holds, lock, by)
                if keep_odd:
                    member.odd = odd
                return reports

            return tuple(itertools.chain.from_iterable(await self._links.each(order)))
        finally:
            self._is_ordering = False

    async def _order(
        self, part: _Part, reason: Reason, holds: bool, lock: bool, by: str
    ) -> tuple[MotorReport, ...]:
        reports = await self._links.stop(part.config, ordered(reason, part.config, holds), by, lock)
        try:
            await self._refresh(part)
        except (AskTimeout, Unreachable) as failure:
            self._down = self._down or f"{part.config.name}: {failure}"
        return reports

    # -- readings

    def _merged(self) -> Observation:
        """Return the newest reading of each part as one reading of the robot."""
        statuses = [part.status for part in self._parts.values()]
        read = [status.observation for status in statuses if status is not None and status.observation is not None]
        if len(read) != len(self._parts):
            raise WireDown("a part has not been read yet")
        sensors: dict[str, tuple[float, ...]] = {}
        faults: dict[str, str] = {}
        for part, observation in zip(self._parts.values(), read, strict=True):
            prefix = part.config.prefix
            sensors |= {prefix + name: row for name, row in observation.sensors.items()}
            faults |= {prefix + axis: text for axis, text in observation.faults.items()}
            sensors[prefix + PART_STATE] = (part.state,)
            if part.state:
                faults[part.config.name] = part.cause
        chain = itertools.chain.from_iterable
        return Observation(
            min(observation.t_ns for observation in read),
            tuple(chain(observation.position for observation in read)),
            tuple(chain(observation.stamp_ns for observation in read)),
            tuple(chain(each.velocity for each in read)) if all(each.velocity for each in read) else (),
            sensors,
            faults,
        )

    def close(self) -> None:
        self._scope.cancel()


def _text(answer: Message | None) -> str:
    return answer.text if isinstance(answer, Refused) else "no answer"

"""The five steps of a drill. Each has setpoints on the wire that move nothing, breaks one thing,
waits for proof.

Proof is what the motors say: every one read back on the safe state that the driver declares. On a
twin there is the wire's log, too: when the first safe frame was on it, and that no setpoint
followed.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from time import monotonic_ns
from typing import assert_never

import trio
from msgspec.structs import replace

from strands_actors.caller.processes import NotConnected
from strands_actors.caller.tree import RobotTree
from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.process import wait_for_end_of
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.gate.messages import Resumed, StopReport
from strands_actors.supervisors.stop_result import Confirmed, NothingRan, StopResult, Unconfirmed, Unreachable
from strands_actors.supervisors.wire.transport import BACKOFF_S
from strands_actors.testing.twin import Twin
from strands_actors.testing.wirelog import WireLog

from .certificate import Figure

PROVIDER = "strands_actors.surfaces.drill.policy:Still"
STEPS_BEFORE = 5
"""Setpoints on the wire before something is broken."""
PATIENCE_S = 10.0
SETTLE_S = 0.4
"""How long the wire is watched for setpoints afterwards."""
AWAY_S = 1.0
"""How long a twin's cable is out."""
HAND_S = 90.0
"""How long a person may take to pull a cable, and to put it back."""
RETURN_S = BACKOFF_S[-1] + 1.0

Ask = Callable[[str], Awaitable[None]]
"""Tells the operator what to do."""


class Failed(Exception):
    """The step did not show what it has to."""


def runs_policies(driver: Driver) -> bool:
    """In a process of their own, which can be killed."""
    return not (driver.ROLLOUTS or driver.TASKS)


class Drill:
    """On a connected robot. ``twin``: the process behind its wire, if it is one."""

    def __init__(self, tree: RobotTree, twin: Twin | None, tell: Ask) -> None:
        self._tree = tree
        self._twin = twin
        self._tell = tell
        self._driver = tree.driver

    @property
    def steps(self) -> dict[str, Callable[[], Awaitable[Figure]]]:
        """By name, in their order. A robot that runs no policies has no policy to kill."""
        steps: dict[str, Callable[[], Awaitable[Figure]]] = {
            "stop": self.stop,
            "policy kill": self.policy_kill,
            "wire kill": self.wire_kill,
            "root freeze": self.root_freeze,
            "link loss": self.link_loss,
        }
        if not runs_policies(self._driver):
            del steps["policy kill"]
        return steps

    # -- the steps

    async def stop(self) -> Figure:
        async with self._writing():
            began_ns = monotonic_ns()
            report = _report_in(await self._tree.stop())
        bound_s = self._driver.bound_s
        return await self._judge("stop", Reason.STOP, began_ns, bound_s, report, ("SAF-002", "SAF-005"))

    async def policy_kill(self) -> Figure:
        async with self._writing():
            began_ns = self._signal("policy", await self._pid("policy"), signal.SIGKILL)
            report = await self._report_of(began_ns, Reason.POLICY)
        proves = ("SAF-002", "SAF-003", "SAF-006")
        return await self._judge("policy kill", Reason.POLICY, began_ns, self._driver.bound_s, report, proves)

    async def wire_kill(self) -> Figure:
        async with self._writing():
            began_ns = self._signal("wire", await self._pid("wire"), signal.SIGKILL)
            report = await self._report_of(began_ns, Reason.WIRE)
        proves = ("SAF-002", "SAF-003", "SAF-008")
        return await self._judge("wire kill", Reason.WIRE, began_ns, self._driver.bound_s, report, proves)

    async def root_freeze(self) -> Figure:
        """The wire process makes safe by itself and ends; its exit code says whether every motor
        confirmed."""
        async with self._writing():
            root, wire = await self._pid("root"), await self._pid("wire")
            began_ns = self._signal("root", root, signal.SIGSTOP)
            try:
                with trio.move_on_after(PATIENCE_S) as waiting:
                    await wait_for_end_of(wire)
                ended_ns, code = monotonic_ns(), exit_code(wire)
            finally:
                os.kill(root, signal.SIGKILL)  # nobody else may: its wire is gone, and it knows nothing of it
        bound_s = self._driver.timing.heartbeat_ttl_s + self._driver.bound_s
        if waiting.cancelled_caught:
            problem = "the wire process did not notice that its root is frozen"
            return self._failed("root freeze", Reason.ROOT, bound_s, problem)
        report = StopReport(Reason.ROOT, self._driver.fallbacks[Reason.ROOT], 0, code == 0, (), at_ns=ended_ns)
        return await self._judge(
            "root freeze", Reason.ROOT, began_ns, bound_s, report, ("SAF-002", "SAF-003", "SAF-004")
        )

    async def link_loss(self) -> Figure:
        """The clock begins before the cable is out: at the last look at which the link was there. So
        the bound is the time without a cable, and ``RETURN_S``."""
        async with self._writing():
            if self._twin is not None:
                began_ns = monotonic_ns()
                await trio.to_thread.run_sync(self._twin.unplug)
                await self._until_mode(AWAY_S + PATIENCE_S, Mode.LOST, Mode.DOWN)
                back_ns = monotonic_ns()
                await trio.to_thread.run_sync(self._twin.plug)
            else:
                await self._tell("Pull the robot's cable now.")
                began_ns = await self._until_mode(HAND_S, Mode.LOST, Mode.DOWN)
                await self._tell("It is noticed. Put the cable back.")
                await self._until_linked(HAND_S)
                back_ns = monotonic_ns()
            # An SDK that cannot do without its link ends its wire process, which the root may see
            # first.
            report = await self._report_of(began_ns, Reason.LINK, Reason.WIRE)
        proves = ("SAF-002", "SAF-008", "SAF-012")
        reason = report.reason if report is not None else Reason.LINK
        bound_s = (back_ns - began_ns) / NS + RETURN_S
        return await self._judge("link loss", reason, began_ns, bound_s, report, proves)

    # -- before and after

    @contextlib.asynccontextmanager
    async def _writing(self) -> AsyncIterator[None]:
        """Setpoints on the wire that keep the robot where it is. Raise ``Failed`` when there are
        none."""
        tree = self._tree
        status = await tree.status()
        if status is None or status.mode != Mode.ARMED:
            answer = await self._resume()
            if not isinstance(answer, Resumed):
                raise Failed(f"it cannot be energised: {answer.text}")
        if self._driver.BEFORE_MOTION:
            prepared = await tree.perform(self._driver.BEFORE_MOTION, {})
            if isinstance(prepared, Refused):
                raise Failed(prepared.text)
        if not runs_policies(self._driver):
            async with trio.open_nursery() as nursery:
                await nursery.start(self._send_still)
                yield
                nursery.cancel_scope.cancel()
            return
        started = await tree.rollouts.start_task(PROVIDER, {"axes": list(self._driver.axes)}, "drill", 3600.0, None)
        if isinstance(started, Refused):
            raise Failed(f"no policy starts: {started.text}")
        with trio.move_on_after(PATIENCE_S):
            while (task := await tree.rollouts.task()).running and task.steps < STEPS_BEFORE:  # noqa: ASYNC110  # remote
                await trio.sleep(0.02)
        if task.steps < STEPS_BEFORE:
            raise Failed(f"the policy writes nothing: {task.exit_reason} {task.refusal or task.exit_detail}")
        yield

    async def _resume(self) -> Resumed | Refused:
        """A wire that was just started again may need a moment."""
        answer: Resumed | Refused = Refused(Code.NO_ANSWER, f"no answer within {PATIENCE_S:g} s")
        with trio.move_on_after(PATIENCE_S):
            while True:
                try:
                    answer = await self._tree.resume()
                except NotConnected as why:
                    answer = Refused(Code.NOT_CONNECTED, str(why))
                if isinstance(answer, Resumed):
                    break
                await trio.sleep(0.1)
        return answer

    async def _send_still(self, task_status: trio.TaskStatus[None]) -> None:
        """One axis, and the others are held where they are: of a robot that lies, some lean on
        their end stops, past what may be commanded. Started once some have been accepted. Raise
        ``Failed`` when they are not."""
        observation = await self._tree.observe()
        if isinstance(observation, Refused):
            raise Failed(observation.text)
        axes = iter(self._driver.as_json(observation.position).items())
        here = dict(axes) if self._driver.WHOLE_ACTIONS else dict([next(axes)])
        accepted = 0
        while True:
            answer = await self._tree.send_action(here)
            if not isinstance(answer, Refused):
                accepted += 1
                if accepted == STEPS_BEFORE:
                    task_status.started()
            elif not accepted and (other := next(axes, None)):
                here = dict([other])
            elif accepted < STEPS_BEFORE:
                raise Failed(answer.text)
            await trio.sleep(1 / self._driver.timing.control_hz)

    async def _judge(
        self,
        step: str,
        reason: Reason,
        began_ns: int,
        bound_s: float,
        report: StopReport | Refused | None,
        proves: tuple[str, ...],
    ) -> Figure:
        """What the motors said, then what the wire's log says, then that no command passes before a
        resume."""
        if report is None:
            return self._failed(step, reason, bound_s, f"nobody reported a safe state within {PATIENCE_S:g} s")
        if isinstance(report, Refused):
            return self._failed(step, reason, bound_s, report.text)
        confirmed_ms = (report.at_ns - began_ns) / 1e6
        if confirmed_ms < 0:
            problem = f"its proof is from {-confirmed_ms:.0f} ms before the fault"
            return self._failed(step, reason, bound_s, problem)
        if not report.confirmed:
            named = ", ".join(report.unconfirmed) or "a motor"
            return self._failed(step, reason, bound_s, f"not confirmed by {named}", confirmed_ms)
        if confirmed_ms > (limit_ms := (bound_s + self._driver.timing.safe_s) * 1e3):
            problem = f"confirmed after {confirmed_ms:.0f} ms, later than {limit_ms:.0f} ms"
            return self._failed(step, reason, bound_s, problem, confirmed_ms)
        safe_state = self._driver.fallbacks[reason]
        if report.safe_state != safe_state:
            return self._failed(
                step, reason, bound_s, f"brought to {report.safe_state}, declared is {safe_state}", confirmed_ms
            )
        await trio.sleep(SETTLE_S)
        if not self._driver.energised(safe_state) and (problem := await self._moves()):
            return self._failed(step, reason, bound_s, problem, confirmed_ms)
        motors = f"{len(report.motors)} motors read back" if report.motors else "read back by the wire process"
        by = " by the stop channel" if report.path == "stop_channel" else ""
        figure = Figure(step, True, safe_state, None, confirmed_ms, bound_s * 1e3, None, motors + by, proves)
        return figure if self._twin is None else self._with_log(figure, self._twin.log, began_ns)

    def _with_log(self, figure: Figure, log: WireLog, began_ns: int) -> Figure:
        safe = next(
            (entry for entry in log.host("safe", began_ns) if entry.safe_state in (None, figure.safe_state)), None
        )
        if safe is None:
            return replace(
                figure, passed=False, detail=f"no frame on the wire brings all motors to {figure.safe_state}"
            )
        safe_ms, after = (safe.t_ns - began_ns) / 1e6, log.setpoints_after_safe(began_ns)
        figure = replace(figure, safe_ms=round(safe_ms, 1), setpoints_after=after)
        if after:
            return replace(figure, passed=False, detail=f"{after} setpoints after the safe frame")
        if safe_ms > figure.bound_ms:
            return replace(figure, passed=False, detail=f"safe after {safe_ms:.0f} ms, past the bound")
        return figure

    def _failed(
        self, step: str, reason: Reason, bound_s: float, problem: str, confirmed_ms: float | None = None
    ) -> Figure:
        return Figure(step, False, self._driver.fallbacks[reason], None, confirmed_ms, bound_s * 1e3, None, problem)

    async def _moves(self) -> str:
        """Return whether a command passes although nobody has resumed."""
        status = await self._tree.status()
        if status is not None and status.mode in (Mode.ARMED, Mode.ARMING):
            return "it was armed again by itself"
        return ""

    # -- seen from outside

    async def _pid(self, role: str) -> int:
        report = await self._tree.describe()
        for process in report.processes if report is not None else ():
            if process.role == role:
                return process.pid
        raise Failed(f"there is no {role} process")

    def _signal(self, role: str, pid: int, number: signal.Signals) -> int:
        began_ns = monotonic_ns()
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            raise Failed(f"the {role} process has ended by itself") from None
        return began_ns

    async def _report_of(self, since_ns: int, *reasons: Reason) -> StopReport | None:
        """Of the gate, or of the root's own path: a stop for such a reason that was confirmed;
        failing that, one that was not. While a cable is out none can be, and each tries."""
        found = None
        with trio.move_on_after(PATIENCE_S):
            while found is None or not found.confirmed:
                status, tree = await self._tree.status(), await self._tree.describe()
                for report in (status and status.last_stop, tree and tree.last_stop):
                    if report and report.reason in reasons and report.at_ns >= since_ns:
                        found = report if found is None or report.confirmed else found
                await trio.sleep(0.02)
        return found

    async def _until_mode(self, within_s: float, *modes: Mode) -> int:
        """Return when the robot was last seen in another mode."""
        before_ns = monotonic_ns()
        with trio.move_on_after(within_s):
            while True:
                asked_ns = monotonic_ns()
                status = await self._tree.status()
                if status is not None and status.mode in modes:
                    return before_ns
                if status is not None:
                    before_ns = asked_ns
                await trio.sleep(0.02)
        raise Failed(f"the robot's link was not lost within {within_s:g} s")

    async def _until_linked(self, within_s: float) -> None:
        with trio.move_on_after(within_s):
            while True:
                status = await self._tree.status()
                if status is not None and status.connected:
                    return
                await trio.sleep(0.02)
        raise Failed(f"the robot did not come back within {within_s:g} s")


def _report_in(result: StopResult) -> StopReport | Refused:
    """Return the report that a stop has led to, or why there is none."""
    match result:
        case Confirmed(NothingRan(why)):
            return Refused(Code.NOTHING_RAN, why, verb="stop")
        case Confirmed(StopReport() as report) | Unconfirmed(report):
            return report
        case Unreachable(refusal):
            return refusal
        case Confirmed():
            raise AssertionError(result)
        case _:
            assert_never(result)


def exit_code(pid: int) -> int | None:
    """Of a process that nobody has waited for yet; None when it is not told. Last field of
    /proc/PID/stat."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return os.waitstatus_to_exitcode(int(fields[-1]))

"""The five steps of a drill.

Each step sends setpoints that move nothing, causes one fault (or a stop), and waits for the proof that the
robot is safe.

The proof is a reading of every motor: each must be in the safe state that the driver declares. A simulated
robot also logs all frames that are sent to it. The log must show that the first safe frame (a frame that
brings the robot to the safe state) was sent in time, and that no setpoint followed.

    step          fault                                    the robot is stopped by
    stop          no fault, a stop is ordered              the gate (the actor that checks commands)
    policy kill   SIGKILL of the policy process            the root, through the gate
    wire kill     SIGKILL of the wire process              the root, by its own stop channel
    root freeze   SIGSTOP of the root process              the wire process, which then exits
    link loss     the cable is pulled and put back         the transport, when the link is back
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

from strands_actors.caller.processes.robot_processes import NotConnected
from strands_actors.caller.session.tree import RobotTree
from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.process import wait_for_end_of
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.gate.messages import Resumed, StopReport
from strands_actors.supervisors.stop_result import Confirmed, NothingRan, StopResult, Unconfirmed, Unreachable
from strands_actors.supervisors.wire.transport import BACKOFF_S
from strands_actors.testing.twin import Twin
from strands_actors.testing.wirelog import WireLog

from . import refusals
from .certificate import StepResult

PROVIDER = "strands_actors.surfaces.drill.policy:Still"
STEPS_BEFORE = 5
"""Setpoints on the wire before the fault."""
PATIENCE_S = 10.0
SETTLE_S = 0.4
"""How long the wire is watched for setpoints after the safe state was confirmed."""
AWAY_S = 1.0
"""How long a twin's cable is out."""
HAND_S = 90.0
"""How long a person may take to pull a cable, and to put it back."""
RETURN_S = BACKOFF_S[-1] + 1.0
"""Longest time from the return of the cable to the safe state: the longest pause between two attempts to
open the link, and a second."""

Ask = Callable[[str], Awaitable[None]]
"""Tells the operator what to do."""


class Failed(Exception):
    """A step could not be carried out, or did not prove that the robot is safe."""


def runs_policies(driver: Driver) -> bool:
    """Return True if policies of this robot run in a separate process, which can be killed."""
    return not (driver.ROLLOUTS or driver.TASKS)


class Drill:
    """A drill on a connected robot.

    Args:
        tree: The connected robot.
        twin: The simulated robot. None for a real robot.
        tell: Called with each instruction for the operator.
    """

    def __init__(self, tree: RobotTree, twin: Twin | None, tell: Ask) -> None:
        self._tree = tree
        self._twin = twin
        self._tell = tell
        self._driver = tree.driver

    @property
    def steps(self) -> dict[str, Callable[[], Awaitable[StepResult]]]:
        """Return the steps by name, in their order. The step ``policy kill`` is missing if the robot does not
        run policies in a separate process."""
        steps: dict[str, Callable[[], Awaitable[StepResult]]] = {
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

    async def stop(self) -> StepResult:
        async with self._writing():
            began_ns = monotonic_ns()
            report = _report_in(await self._tree.stop())
        bound_s = self._driver.bound_s
        return await self._judge("stop", Reason.STOP, began_ns, bound_s, report, ("SAF-002", "SAF-005"))

    async def policy_kill(self) -> StepResult:
        async with self._writing():
            began_ns = self._signal("policy", await self._pid("policy"), signal.SIGKILL)
            report = await self._report_of(began_ns, Reason.POLICY)
        proves = ("SAF-002", "SAF-003", "SAF-006")
        return await self._judge("policy kill", Reason.POLICY, began_ns, self._driver.bound_s, report, proves)

    async def wire_kill(self) -> StepResult:
        async with self._writing():
            began_ns = self._signal("wire", await self._pid("wire"), signal.SIGKILL)
            report = await self._report_of(began_ns, Reason.WIRE)
        proves = ("SAF-002", "SAF-003", "SAF-008")
        return await self._judge("wire kill", Reason.WIRE, began_ns, self._driver.bound_s, report, proves)

    async def root_freeze(self) -> StepResult:
        """Freeze the root process. The wire process must then stop the robot by itself and end. Its exit code
        shows if every motor has confirmed the stop."""
        async with self._writing():
            root, wire = await self._pid("root"), await self._pid("wire")
            began_ns = self._signal("root", root, signal.SIGSTOP)
            try:
                with trio.move_on_after(PATIENCE_S) as waiting:
                    await wait_for_end_of(wire)
                ended_ns, code = monotonic_ns(), exit_code(wire)
            finally:
                # The frozen root process cannot notice that the wire process has ended, and no other process
                # kills it.
                os.kill(root, signal.SIGKILL)
        bound_s = self._driver.timing.heartbeat_ttl_s + self._driver.bound_s
        if waiting.cancelled_caught:
            problem = "the wire process did not notice that its root is frozen"
            return self._failed("root freeze", Reason.ROOT, bound_s, problem)
        report = StopReport(Reason.ROOT, self._driver.fallbacks[Reason.ROOT], 0, code == 0, (), at_ns=ended_ns)
        return await self._judge(
            "root freeze", Reason.ROOT, began_ns, bound_s, report, ("SAF-002", "SAF-003", "SAF-004")
        )

    async def link_loss(self) -> StepResult:
        """Ask the operator to pull the robot's cable and to put it back. The link of a simulated robot is cut
        without an operator.

        A stop can be confirmed only after the cable is back. The measured time begins at the last moment at
        which the link was seen, so the bound is the time without a cable plus ``RETURN_S``.
        """
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
            # With some SDKs, the loss of the link ends the wire process. Then the root process may report the
            # stop with Reason.WIRE, so accept this reason, too.
            report = await self._report_of(began_ns, Reason.LINK, Reason.WIRE)
        proves = ("SAF-002", "SAF-008", "SAF-012")
        reason = report.reason if report is not None else Reason.LINK
        bound_s = (back_ns - began_ns) / NS + RETURN_S
        return await self._judge("link loss", reason, began_ns, bound_s, report, proves)

    # -- before and after each step

    @contextlib.asynccontextmanager
    async def _writing(self) -> AsyncIterator[None]:
        """Energise the robot, and send setpoints that keep it in place while the block runs. Raise ``Failed``
        if this is not possible."""
        tree = self._tree
        status = await tree.status()
        if status is None or status.mode != Mode.ARMED:
            answer = await self._resume()
            if not isinstance(answer, Resumed):
                raise Failed(f"the robot cannot be energised: {answer.text}")
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
            raise Failed(f"the policy cannot be started: {started.text}")
        with trio.move_on_after(PATIENCE_S):
            while (task := await tree.rollouts.task()).running and task.steps < STEPS_BEFORE:  # noqa: ASYNC110  # remote
                await trio.sleep(0.02)
        if task.steps < STEPS_BEFORE:
            raise Failed(f"the policy sends no setpoints: {task.exit_reason} {task.refusal or task.exit_detail}")
        yield

    async def _resume(self) -> Resumed | Refused:
        """Resume the robot. Try for up to ``PATIENCE_S``, since a wire process (which communicates with the
        robot) that was just restarted needs time."""
        answer: Resumed | Refused = refusals.not_resumed(PATIENCE_S)
        with trio.move_on_after(PATIENCE_S):
            while True:
                try:
                    answer = await self._tree.resume()
                except NotConnected as error:
                    answer = refusals.not_connected(error)
                if isinstance(answer, Resumed):
                    break
                await trio.sleep(0.1)
        return answer

    async def _send_still(self, task_status: trio.TaskStatus[None]) -> None:
        """Send setpoints that keep one axis at its present position. The other axes are held, too.

        When a robot lies down, some axes lean on their end stops, outside the permitted range, and their
        setpoints are refused. So the axes are tried one after the other. ``started()`` is called after
        ``STEPS_BEFORE`` accepted setpoints. Raise ``Failed`` if no axis is accepted.
        """
        observation = await self._tree.observe()
        if isinstance(observation, Refused):
            raise Failed(observation.text)
        axes = iter(self._driver.as_json(observation.position).items())
        positions = dict(axes) if self._driver.WHOLE_ACTIONS else dict([next(axes)])
        accepted = 0
        while True:
            answer = await self._tree.send_action(positions)
            if not isinstance(answer, Refused):
                accepted += 1
                if accepted == STEPS_BEFORE:
                    task_status.started()
            elif not accepted and (next_axis := next(axes, None)):
                positions = dict([next_axis])
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
    ) -> StepResult:
        """Decide if a step was passed: by the motors' states in the report of the stop, by the mode (no motion
        before a resume), and for a simulated robot by its log of frames."""
        if report is None:
            return self._failed(step, reason, bound_s, f"no process reported a safe state within {PATIENCE_S:g} s")
        if isinstance(report, Refused):
            return self._failed(step, reason, bound_s, report.text)
        confirmed_ms = (report.at_ns - began_ns) / 1e6
        if confirmed_ms < 0:
            problem = f"the stop was reported {-confirmed_ms:.0f} ms before the fault"
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
                step,
                reason,
                bound_s,
                f"the robot was brought to {report.safe_state}, but {safe_state} is declared",
                confirmed_ms,
            )
        await trio.sleep(SETTLE_S)
        if not self._driver.energised(safe_state) and (problem := await self._moves()):
            return self._failed(step, reason, bound_s, problem, confirmed_ms)
        motors = f"{len(report.motors)} motors read back" if report.motors else "read back by the wire process"
        by = " by the stop channel" if report.path == "stop_channel" else ""
        result = StepResult(step, True, safe_state, None, confirmed_ms, bound_s * 1e3, None, motors + by, proves)
        return result if self._twin is None else self._with_log(result, self._twin.log, began_ns)

    def _with_log(self, result: StepResult, log: WireLog, began_ns: int) -> StepResult:
        first = SafeState(result.safe_state).first
        safe = next((entry for entry in log.host("safe", began_ns) if entry.safe_state in (None, first)), None)
        if safe is None:
            return replace(result, passed=False, detail=f"no frame on the wire brings all motors to {first}")
        safe_ms, after = (safe.t_ns - began_ns) / 1e6, log.setpoints_after_safe(began_ns)
        result = replace(result, safe_ms=round(safe_ms, 1), setpoints_after=after)
        if after:
            return replace(result, passed=False, detail=f"{after} setpoints after the safe frame")
        if safe_ms > result.bound_ms:
            return replace(result, passed=False, detail=f"safe after {safe_ms:.0f} ms, later than the bound")
        return result

    def _failed(
        self, step: str, reason: Reason, bound_s: float, problem: str, confirmed_ms: float | None = None
    ) -> StepResult:
        return StepResult(
            step, False, self._driver.fallbacks[reason], None, confirmed_ms, bound_s * 1e3, None, problem
        )

    async def _moves(self) -> str:
        """Return an error text if the robot was energised again without a resume."""
        status = await self._tree.status()
        if status is not None and status.mode in (Mode.ARMED, Mode.ARMING):
            return "the robot was energised again without a resume"
        return ""

    # -- read the state of the robot's processes

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
        """Wait up to ``PATIENCE_S`` until the robot reports a stop for one of these reasons. Return a confirmed
        report if there is one, else an unconfirmed report, else None. While the cable is out, no stop can be
        confirmed."""
        best = None
        with trio.move_on_after(PATIENCE_S):
            while best is None or not best.confirmed:
                status, tree = await self._tree.status(), await self._tree.describe()
                for report in (status and status.last_stop, tree and tree.last_stop):
                    if report and report.reason in reasons and report.at_ns >= since_ns:
                        best = report if best is None or report.confirmed else best
                await trio.sleep(0.02)
        return best

    async def _until_mode(self, within_s: float, *modes: Mode) -> int:
        """Wait until the robot is in one of these modes. Return the last time at which it was in another
        mode."""
        before_ns = monotonic_ns()
        with trio.move_on_after(within_s):
            while True:
                requested_ns = monotonic_ns()
                status = await self._tree.status()
                if status is not None and status.mode in modes:
                    return before_ns
                if status is not None:
                    before_ns = requested_ns
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
    """Return the report (with the state of each motor) in the result of a stop. If the result has no report,
    return a refusal with the reason."""
    match result:
        case Confirmed(NothingRan(reason)):
            return refusals.nothing_ran(reason)
        case Confirmed(StopReport() as report) | Unconfirmed(report):
            return report
        case Unreachable(refusal):
            return refusal
        case Confirmed():
            raise AssertionError(result)
        case _:
            assert_never(result)


def exit_code(pid: int) -> int | None:
    """Return the exit code of a process that has ended, and that its parent has not collected yet. It is the
    last field of /proc/PID/stat. None if it cannot be read."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return os.waitstatus_to_exitcode(int(fields[-1]))

"""Connect the wire process to a Franka controller. It begins and stops motions. Another process sends their
commands (``cycle``)."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping
from typing import Any

import msgspec
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.drivers.common.ports.receive_budget import ReceiveBudget
from strands_actors.drivers.franka.refusals import FrankaCode
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.health.heartbeat import Heartbeat, new_page, words_of
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.process import ChildProcess, start

from . import protocol as p
from .client import LOOK_S, STATES_SIZE, Fci, connect
from .config import FrankaConfig
from .cycle import CYCLE_END, ENTRY, LARGEST, STAND_DOWN, WIRE_END, Order, Report
from .gates import LOST, POOR, REASONS, refuse_mode
from .stop_channel import CONFIRM_S, FrankaStopChannel, moving, reports

BEGIN_S = 3.0
"""Timeout for the start of the process of the cycle, on a busy machine."""
OLD_S = 0.02
"""A setpoint is not written after this long without a state: that is 20 missing ones."""
ENDS_S = 1.0
"""Longest wait for the end of the previous motion. One that runs longer belongs to another client, and no motion is
begun after it."""
RECOVER_S = 5.0

_BY_US = ("success", "preempted")
"""Statuses of motions that we ended ourselves."""


class FrankaSession:
    """The state that exists between ``open`` and ``close``."""

    def __init__(self, config: FrankaConfig, client: Fci, clock: Clock) -> None:
        self.client = client
        self._clock = clock
        self._dialect = client.dialect
        with contextlib.ExitStack() as given:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            page = new_page()
            given.callback(os.close, page)
            udp = given.enter_context(client.udp)  # It belongs to the child from now on.
            given.enter_context(theirs)
            arguments = {
                "fci": config.arm.fci,
                "limits": msgspec.to_builtins(config.limits),
                "stride": config.stride,
                "udp": udp.fileno(),
                "wire": theirs.fileno(),
                "page": page,
                "parent": os.getpid(),
            }
            given.enter_context(ours)
            self.child: ChildProcess = start(ENTRY, arguments, (udp.fileno(), theirs.fileno(), page))
            self._reports = ours.dup()
            self._budget = ReceiveBudget("the process of the 1 kHz cycle", size=STATES_SIZE)
            self.heartbeat: Heartbeat = Heartbeat(words_of(page), WIRE_END, CYCLE_END)
        self._reports.setblocking(False)
        self.report: Report | None = None
        self.state: p.State | None = None
        self.order: Order | None = None  # the last order; None after it was cancelled
        self.motion = 0  # number of the Move that runs; 0 without a motion
        self.lost = ""  # the reason why the controller ended a motion of ours
        self._orders = 0
        self.answers: dict[int, int] = {}  # status by number, of all requests except the Move

    def look(self) -> None:
        """Process the received reports and replies. Never waits. Raise ``WireDown``."""
        for data in self._budget.turn(self._report):
            try:
                report = Report.unpack(data)
                self.state, self.report = self._dialect.state(report.state), report
            except MalformedFrame:
                continue  # It is malformed. The last state ages.
        for reply in self.client.replies():
            self._take(reply)

    def _report(self) -> bytes | None:
        try:
            return self._reports.recv(LARGEST)
        except BlockingIOError:
            return None
        except OSError:
            raise WireDown("the process of the 1 kHz cycle is gone") from None

    def _take(self, reply: p.Message) -> None:
        try:
            status = p.status_of(reply)
        except MalformedFrame as error:
            raise WireDown(f"read: {error}. Is this a Franka controller?") from None
        if reply.id != self.motion or not self.motion:
            self.answers[reply.id] = status
            return
        name = self._dialect.move_status(status)
        if name == "motion_started":
            return
        self.motion = 0
        if name not in _BY_US:
            self.lost = name
            self.stand_down()

    def silent_s(self) -> float:
        """Return the time since the last state."""
        return (self._clock.now_ns() - self.heartbeat.heard_ns) / NS

    def aim(self, goal: tuple[float, ...]) -> None:
        """Send a goal to the process of the cycle."""
        self._orders += 1
        self.order = Order(self._orders, goal)
        try:
            self._reports.send(self.order.pack())
        except OSError:
            raise WireDown("the process of the 1 kHz cycle takes no orders") from None

    def stand_down(self) -> None:
        """Cancel the order, so that no further command leaves. The controller has received a stop, or has ended the
        motion."""
        self.order = None
        try:
            self._reports.send(STAND_DOWN.pack())
        except OSError:
            self.child.kill()

    def close(self) -> None:
        """Close the connection first, so that the controller ends any motion."""
        self.client.close()
        self.child.kill()
        trio.lowlevel.spawn_system_task(self.child.wait)
        self._reports.close()
        self.child.socket.close()


class FrankaWire(SessionWire[FrankaSession]):
    def __init__(self, config: FrankaConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._waits_since_ns = 0  # since when a target waits for the end of the previous motion; 0 for no target

    @property
    def prompt(self) -> bool:
        return True

    async def open(self) -> dict[str, Any]:
        self.close()
        config = self._config
        try:
            host = config.host
        except ValueError as error:
            raise WireDown(f"open: {error}") from None
        client = await connect(host, config.arm.fci, config.robot)
        try:
            session = FrankaSession(config, client, self._clock)
        except OSError as error:
            client.close()
            raise WireDown(f"open: no process for the 1 kHz cycle ({error.strerror})") from None
        self.session_or_none = session
        with trio.move_on_after(BEGIN_S):
            while session.state is None:
                if not session.child.alive:
                    raise WireDown("open: the process of the 1 kHz cycle has ended. What it says is above")
                session.look()
                await trio.sleep(LOOK_S)
        if session.state is None:
            raise WireDown(f"open: no state has passed the 1 kHz cycle within {BEGIN_S:g} s")
        return {
            "address": host,
            "fci": config.arm.fci,
            "speed_factor": config.speed_factor,
            "state_hz": p.STATE_HZ,
            "stride": config.stride,
            "stream_rate_hz": p.STATE_HZ / config.stride,
            "cycle_scheduling": scheduling_of(session.child.pid),
        }

    async def arm(self, permit: Permit) -> Observation:
        """Check that the arm may move. The controller holds the arm, so there is nothing to energise, and nothing
        moves before the first setpoint."""
        session = self.session
        session.look()
        state = self._state(session)
        refusal = refuse_mode(state.robot_mode, ", ".join(state.reasons))
        if refusal is not None:
            raise WireDown(refusal.text)
        if state.robot_mode != p.RobotMode.IDLE:
            raise WireDown("somebody else moves the arm. End that program, then resume()")
        if (silent_s := session.silent_s()) > self._config.state_ttl_s:
            raise WireDown(f"no state for {silent_s * 1e3:.0f} ms. Check the controller and its network")
        permit.check()
        session.lost, self._waits_since_ns = "", 0
        return self._observation(session, state)

    async def read(self) -> Observation:
        session = self.session
        session.look()
        state = self._state(session)
        silent_s = session.silent_s()
        if silent_s > self._config.state_ttl_s:
            if not session.child.alive:
                raise WireDown("read: the process of the 1 kHz cycle has ended")
            raise WireDown(f"read: no state for {silent_s * 1e3:.0f} ms. Check the controller and its network")
        return self._observation(session, state)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Write a target.

        If no motion can begin just now, nothing is written and no error is raised. The transport re-sends an
        accepted setpoint while it is valid, so the motion begins with a later call.
        """
        session = self.session
        session.look()
        state = self._state(session)
        if session.lost or refuse_mode(state.robot_mode, "") is not None:
            raise PermitDenied(session.lost or p.mode_name(state.robot_mode))
        permit.check()
        if session.silent_s() > OLD_S:
            return
        session.heartbeat.beat(self._clock.now_ns())
        order = session.order
        if order is not None and values == order.goal and (session.motion or self._reached(session, order)):
            return
        if not session.motion:
            if state.robot_mode != p.RobotMode.IDLE:
                self._wait_for_the_end(session)
                return
            self._waits_since_ns = 0
            session.aim(values)  # Do this first, so that the first state of the motion is answered.
            session.motion = session.client.start_motion()
            return
        session.aim(values)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        session = self.session_or_none
        if session is None:
            return reports(self._config, False, False, None, "not connected")
        self._waits_since_ns = 0
        written, trouble = False, ""
        try:
            number = session.client.send("stop")
            written, since_ns = True, self._clock.now_ns()
            session.stand_down()
            with trio.move_on_after(CONFIRM_S):
                while not (number in session.answers and self._stands(session, since_ns)):
                    await trio.sleep(LOOK_S)
                    session.look()
            state = session.state if session.report and session.report.stamp_ns > since_ns else None
            trouble = "" if state is not None else "no state since the stop"
            acknowledged = session.answers.pop(number, None) is not None
            return reports(self._config, written, acknowledged, state, trouble)
        except WireDown as down:
            session.stand_down()
            return reports(self._config, written, False, None, str(down))

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Send a stop on the open connection and close it, which ends the motion. Then stop on a new connection."""
        session, written = self.session_or_none, False
        if session is not None:
            with contextlib.suppress(WireDown):
                session.client.send("stop")
                written = True
            session.stand_down()
            session.client.close_in_order()
            self.close()
        motors = await FrankaStopChannel(self._config, (), self._clock).make_safe(safe_state)
        return tuple(msgspec.structs.replace(motor, written=motor.written or written) for motor in motors)

    async def perform(self, service: str, arguments: Mapping[str, Any], permit: Permit) -> dict[str, Any] | Refused:
        session = self.session
        permit.check()
        number = session.client.send(service)
        while number not in session.answers:  # The time limit of the service ends this wait.
            await trio.sleep(LOOK_S)
            session.look()
        status = session.answers.pop(number)
        if status:
            return Refused(
                FrankaCode.NOT_RECOVERED,
                f"the controller refuses (status {status})",
                "look at the arm; release its stop button, or clear the error in Desk",
            )
        return {"recovered": True}

    def close(self) -> None:
        if self.session_or_none is not None:
            self.session_or_none.close()
        self.session_or_none = None

    # -- parts

    def _wait_for_the_end(self, session: FrankaSession) -> None:
        """Wait for the end of the previous motion. After ``ENDS_S`` count it as another client's."""
        now_ns = self._clock.now_ns()
        self._waits_since_ns = self._waits_since_ns or now_ns
        if now_ns - self._waits_since_ns > ENDS_S * NS:
            session.lost = "another one runs, which is not ours"

    def _reached(self, session: FrankaSession, order: Order) -> bool:
        return session.report is not None and session.report.reached == order.number

    def _stands(self, session: FrankaSession, since_ns: int) -> bool:
        """Return whether a state from after ``since_ns`` shows the arm at rest."""
        if session.state is None or session.report is None or session.report.stamp_ns <= since_ns:
            return False
        return not moving(session.state)

    def _state(self, session: FrankaSession) -> p.State:
        if session.state is None:
            raise WireDown("read: no state yet")
        return session.state

    def _observation(self, session: FrankaSession, state: p.State) -> Observation:
        report = session.report
        stamp_ns = report.stamp_ns if report is not None else 0
        faults = {}
        if state.reasons and state.robot_mode == p.RobotMode.REFLEX:
            faults[REASONS] = ", ".join(state.reasons)
        if session.lost:
            faults[LOST] = session.lost
        if state.robot_mode == p.RobotMode.MOVE and state.success_rate < POOR:
            faults["success_rate"] = f"only {state.success_rate:.0%} of the commands reach the controller in time"
        return Observation(
            t_ns=stamp_ns,
            position=state.q,
            stamp_ns=(stamp_ns,) * len(state.q),
            velocity=state.dq,
            sensors={
                "effort_nm": state.tau_J,
                "external_effort_nm": state.tau_ext,
                "flange_m": state.O_T_EE[12:15],
                "robot_mode": (float(state.robot_mode),),
                "success_rate": (state.success_rate,),
                "missed_cycles": (float(report.missed if report is not None else 0),),
            },
            faults=faults,
        )


def scheduling_of(pid: int) -> str:
    """Return the scheduling of a process, for people."""
    if hasattr(os, "sched_getscheduler") and os.sched_getscheduler(pid) == os.SCHED_FIFO:
        return f"SCHED_FIFO {os.sched_getparam(pid).sched_priority}"
    return "ordinary: SCHED_FIFO was not granted; on a busy machine commands will be missed. ulimit -r 13 allows it"

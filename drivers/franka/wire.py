"""Connect the wire process to a Franka controller.

The wire process requests the start and the stop of each motion. Another process (``cycle``) sends a command to the
controller in each millisecond of the motion.
"""

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
from strands_actors.drivers.common.kit.hand_gates import with_hand
from strands_actors.drivers.common.kit.outcome import NOT_CONNECTED
from strands_actors.drivers.common.kit.session_wire import SessionWire
from strands_actors.drivers.common.ports.receive_budget import ReceiveBudget
from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.health.heartbeat import Heartbeat, new_page, words_of
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.process import ChildProcess, start

from . import hand_protocol, refusals
from . import protocol as p
from .arms import JOINTS
from .client import LOOK_S, STATES_SIZE, Fci, connect
from .config import FrankaConfig
from .controller_clock import ControllerClock
from .cycle import CYCLE_END, ENTRY, LARGEST, STAND_DOWN, WIRE_END, Order, Report
from .gates import LOST, POOR, REASONS, refuse_mode
from .hand import FrankaHand
from .stop_channel import CONFIRM_S, FrankaStopChannel, hand_report, moving, reports

BEGIN_S = 3.0
"""Timeout for the start of the 1 kHz process, on a busy computer."""
OLD_S = 0.02
"""If no state has arrived for this time (20 states are missing), no setpoint is written."""
ENDS_S = 1.0
"""Longest wait for the end of the previous motion. A motion that runs longer belongs to another client. The driver
then starts no motion."""
RECOVER_S = 5.0
HOME = "home_gripper"
"""The service that measures the stroke of the hand."""
STAYS_RAD = 1e-3
"""An action of the hand alone keeps the arm's target. No motion begins if the arm is that close to it."""

_BY_US = ("success", "preempted")
"""Statuses of motions that we ended ourselves."""


class FrankaSession:
    """One connection to the controller, from ``open`` to ``close``, with the 1 kHz process that serves it."""

    def __init__(self, config: FrankaConfig, client: Fci, clock: Clock) -> None:
        self.client = client
        self._clock = clock
        self._dialect = client.dialect
        with contextlib.ExitStack() as resources:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            page = new_page()
            resources.callback(os.close, page)
            udp = resources.enter_context(client.udp)  # The child takes over this socket. It is closed here.
            resources.enter_context(theirs)
            arguments = {
                "fci": config.arm.fci,
                "limits": msgspec.to_builtins(config.limits),
                "stride": config.stride,
                "udp": udp.fileno(),
                "wire": theirs.fileno(),
                "page": page,
                "parent": os.getpid(),
            }
            resources.enter_context(ours)
            self.child: ChildProcess = start(ENTRY, arguments, (udp.fileno(), theirs.fileno(), page))
            self._reports = ours.dup()
            self._budget = ReceiveBudget("the process of the 1 kHz cycle", size=STATES_SIZE)
            self.heartbeat: Heartbeat = Heartbeat(words_of(page), WIRE_END, CYCLE_END)
        self._reports.setblocking(False)
        self.report: Report | None = None
        self.state: p.State | None = None
        self.order: Order | None = None  # The last order to the 1 kHz process, or None after it was cancelled.
        self.motion = 0  # Number of the ``move`` request of the running motion. It is 0 without a motion.
        self.lost = ""  # The reason why the controller ended our motion.
        self._orders = 0
        self.controller_clock = ControllerClock()
        self.answers: dict[int, int] = {}  # Status of each reply by request number, except replies to ``move``.

    def look(self) -> None:
        """Process the reports of the 1 kHz process and the replies of the controller that have arrived. Never
        waits.

        Raise ``WireDown`` if a connection is lost.
        """
        for data in self._budget.turn(self._report):
            try:
                report = Report.unpack(data)
                self.state, self.report = self._dialect.state(report.state), report
            except MalformedFrame:
                continue  # Ignore a malformed report and keep the last state. If it gets too old, ``read`` fails.
            self.controller_clock.note(report.stamp_ns, self.state.message_id)
        for reply in self.client.replies():
            self._take(reply)

    def _report(self) -> bytes | None:
        try:
            return self._reports.recv(LARGEST)
        except BlockingIOError:
            return None
        except OSError:
            raise WireDown("the process that sends commands at 1 kHz has ended. Reconnect") from None

    def _take(self, reply: p.Message) -> None:
        try:
            status = p.status_of(reply)
        except MalformedFrame as error:
            raise WireDown(f"read: {error}. Check that port= is a Franka controller") from None
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
        """Return the time in seconds since the controller's last state."""
        return (self._clock.now_ns() - self.heartbeat.last_received_ns) / NS

    def aim(self, goal: tuple[float, ...]) -> None:
        """Send a goal to the 1 kHz process."""
        self._orders += 1
        self.order = Order(self._orders, goal)
        try:
            self._reports.send(self.order.pack())
        except OSError:
            raise WireDown("the process that sends commands at 1 kHz accepts no goal. Reconnect") from None

    def stand_down(self) -> None:
        """Cancel the goal that was sent to the 1 kHz process (its order), so that it sends no further command.

        It is called after a stop was sent, or after the controller has ended the motion.
        """
        self.order = None
        try:
            self._reports.send(STAND_DOWN.pack())
        except OSError:
            self.child.kill()

    def close(self) -> None:
        """Close the connection to the controller, which ends any motion. Then end the 1 kHz process."""
        self.client.close()
        self.child.kill()
        trio.lowlevel.spawn_system_task(self.child.wait)
        self._reports.close()
        self.child.socket.close()


class FrankaWire(SessionWire[FrankaSession]):
    def __init__(self, config: FrankaConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        # Time since which a target has waited for the end of the previous motion. It is 0 if no target waits.
        self._waits_since_ns = 0
        self._hand = FrankaHand(config, clock) if config.gripper else None

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
            raise WireDown(
                f"open: cannot start the process that sends commands at 1 kHz ({error.strerror})"
            ) from None
        self.session_or_none = session
        with trio.move_on_after(BEGIN_S):
            while session.state is None:
                if not session.child.alive:
                    raise WireDown(
                        "open: the process that sends commands at 1 kHz has ended. Its error message is above"
                    )
                session.look()
                await trio.sleep(LOOK_S)
        if session.state is None:
            raise WireDown(
                f"open: the process that receives the controller's states reported no state within {BEGIN_S:g} s. "
                "Close other programs, then try again"
            )
        if self._hand is not None:
            try:
                await self._hand.open()
            except BaseException:
                self.close()
                raise
        return {
            "address": host,
            "fci": config.arm.fci,
            "speed_factor": config.speed_factor,
            "state_hz": p.STATE_HZ,
            "stride": config.stride,
            "stream_rate_hz": p.STATE_HZ / config.stride,
            "cycle_scheduling": scheduling_of(session.child.pid),
            **({"gripper": config.gripper} if config.gripper else {}),
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
            raise WireDown("another program moves the arm. End that program, then call resume()")
        if (silent_s := session.silent_s()) > self._config.state_ttl_s:
            raise WireDown(
                f"the controller has sent no state for {silent_s * 1e3:.0f} ms. "
                "Check the controller and its network"
            )
        permit.check()
        session.lost, self._waits_since_ns = "", 0
        if self._hand is not None:
            await self._hand.arm()
            permit.check()
        return self._observation(session, state)

    async def read(self) -> Observation:
        session = self.session
        session.look()
        state = self._state(session)
        silent_s = session.silent_s()
        if silent_s > self._config.state_ttl_s:
            if not session.child.alive:
                raise WireDown("read: the process that sends commands at 1 kHz has ended. Reconnect")
            raise WireDown(
                f"read: the controller has sent no state for {silent_s * 1e3:.0f} ms. "
                "Check the controller and its network"
            )
        if self._hand is not None:
            self._hand.read(self._clock.now_ns())
        return self._observation(session, state)

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        """Move to a target.

        If a motion cannot begin yet, nothing is written and no error is raised. The caller repeats an accepted
        setpoint while it is valid, so the motion begins at a later call.
        """
        session = self.session
        session.look()
        state = self._state(session)
        if session.lost or refuse_mode(state.robot_mode, "") is not None:
            raise PermitDenied(session.lost or p.mode_name(state.robot_mode))
        permit.check()
        if session.silent_s() > OLD_S:
            return
        if self._hand is not None:
            self._hand.follow(values[JOINTS:], permit)
            if session.order is None and _is_at(state, values[:JOINTS]):
                return
        self._move_to(session, state, values[:JOINTS])

    def _move_to(self, session: FrankaSession, state: p.State, values: tuple[float, ...]) -> None:
        session.heartbeat.beat(self._clock.now_ns())
        order = session.order
        if order is not None and values == order.goal and (session.motion or self._reached(session, order)):
            return
        if not session.motion:
            if state.robot_mode != p.RobotMode.IDLE:
                self._wait_for_the_end(session)
                return
            self._waits_since_ns = 0
            # Send the goal first, so that the 1 kHz process can answer the first state of the motion.
            session.aim(values)
            session.motion = session.client.start_motion()
            return
        session.aim(values)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        hand = self._hand
        if hand is None:
            return await self._make_arm_safe()
        grip = NOT_CONNECTED

        async def keep_grip() -> None:
            nonlocal grip
            grip = await hand.confirm(hand.begin_stop())

        async with trio.open_nursery() as nursery:
            # The new task runs only when the arm waits for its answer, so the arm is stopped first.
            nursery.start_soon(keep_grip)
            motors = await self._make_arm_safe()
        return (*motors, *hand_report(grip, hand.opening))

    async def _make_arm_safe(self) -> tuple[MotorReport, ...]:
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
        """Stop the arm although its connection may be broken.

        Send a stop on the open connection and close it, which ends the motion. Then send a stop on a new
        connection.
        """
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
        if service == HOME:
            return await self._home(permit)
        session = self.session
        permit.check()
        number = session.client.send(service)
        while number not in session.answers:  # The caller cancels this wait at the time limit of the service.
            await trio.sleep(LOOK_S)
            session.look()
        status = session.answers.pop(number)
        if status:
            return refusals.not_recovered(status)
        return {"recovered": True}

    def close(self) -> None:
        if self._hand is not None:
            self._hand.close()
        if self.session_or_none is not None:
            self.session_or_none.close()
        self.session_or_none = None

    # -- helper methods of the wire

    async def _home(self, permit: Permit) -> dict[str, Any] | Refused:
        assert self._hand is not None  # Only an arm with a hand has this service.
        status = await self._hand.home(permit)
        if status != hand_protocol.Status.SUCCESS:
            return refusals.not_homed(hand_protocol.status_name(status))
        return {"homed": True}

    def _wait_for_the_end(self, session: FrankaSession) -> None:
        """Note that a target waits for the end of the previous motion.

        If it has waited for ``ENDS_S``, the motion must be another client's, and no target is accepted any more.
        """
        now_ns = self._clock.now_ns()
        self._waits_since_ns = self._waits_since_ns or now_ns
        if now_ns - self._waits_since_ns > ENDS_S * NS:
            session.lost = "another one runs, which is not ours"

    def _reached(self, session: FrankaSession, order: Order) -> bool:
        return session.report is not None and session.report.reached == order.number

    def _stands(self, session: FrankaSession, since_ns: int) -> bool:
        """Return whether a state that arrived after ``since_ns`` shows the arm at rest."""
        if session.state is None or session.report is None or session.report.stamp_ns <= since_ns:
            return False
        return not moving(session.state)

    def _state(self, session: FrankaSession) -> p.State:
        if session.state is None:
            raise WireDown("read: no state of the controller yet. Check the controller and its network")
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
        observation = Observation(
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
                "controller_hz": (session.controller_clock.hz,),
            },
            faults=faults,
        )
        return observation if self._hand is None else with_hand(observation, self._hand)


def _is_at(state: p.State, goal: tuple[float, ...]) -> bool:
    return all(abs(rad - goal_rad) < STAYS_RAD for rad, goal_rad in zip(state.q_d, goal, strict=True))


def scheduling_of(pid: int) -> str:
    """Return a text for the status: whether the system runs this process with real-time priority."""
    if hasattr(os, "sched_getscheduler") and os.sched_getscheduler(pid) == os.SCHED_FIFO:
        return f"SCHED_FIFO {os.sched_getparam(pid).sched_priority}"
    return "ordinary: SCHED_FIFO was not granted; on a busy machine commands will be missed. ulimit -r 13 allows it"

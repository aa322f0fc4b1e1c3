"""Put back the bugs of earlier versions, each as a patch of a few functions.

One of the nine bugs of the first attack is missing. It was an unreadable note in the run directory, and
concerns the program that looks for robots, which is not simulated (``tests/mesh/test_notes.py``).
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import msgspec
import pytest
import trio

from strands_actors.caller.processes.tree_processes import TreeProcesses
from strands_actors.caller.session.rollouts import Rollouts
from strands_actors.contract.axis import parse_action
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason
from strands_actors.contract.loading import load
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.kernel.channels.permissions import Channel
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.reserve import Reserve
from strands_actors.supervisors.gate import failsafe
from strands_actors.supervisors.gate.failsafe import Event, Mode
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import Release, Released, Stop, StopReport
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.root import process
from strands_actors.supervisors.root.lock_keeper import Kept, LockKeeper
from strands_actors.supervisors.root.tasks import Tasks
from strands_actors.supervisors.stop_result import Confirmed, NothingRan, StopResult
from strands_actors.supervisors.wire import transport
from strands_actors.supervisors.wire.group import WireProcess
from strands_actors.supervisors.wire.transport import Transport

ServoSession: Any = load("strands_actors.drivers.common.servo.wire:ServoSession")
Outcome: Any = load("strands_actors.drivers.common.kit.outcome:Outcome")
reports: Any = load("strands_actors.drivers.unitree.safing:reports")
WIRES_OF_THE_KIT = (
    "rby1.wire:RBY1Wire",
    "spot.wire:SpotWire",
    "yahboom.wire:YahboomWire",
    "earthrover.wire:EarthRoverWire",
    "kuka.wire:KukaWire",
    "crazyflie.wire:CrazyflieWire",
    "kinova.wire:KinovaWire",
    "reachy.wire:ReachyWire",
    "microduck.wire:MicroduckWire",
    "robotiq.wire:RobotiqWire",
    "stretch.wire:StretchWire",
    "booster.wire:BoosterWire",
    "franka.wire:FrankaWire",
)
WAIT_S = 0.3


def a_stop_writes_nothing_on_a_lost_link(patch: pytest.MonkeyPatch) -> None:
    async def reach(self: Transport, safe_state: str, reason: str, began_ns: int) -> tuple[MotorReport, ...]:
        return ()

    patch.setattr(Transport, "_reach", reach)


def a_fault_takes_the_place_of_an_estop(patch: pytest.MonkeyPatch) -> None:
    """The gate forgets an e-stop when a fault follows."""
    patch.setattr(SafetyPage, "order", lambda self, safe_state, lasts=True: SafeState(safe_state))


def a_resume_is_obeyed_while_the_tree_ends(patch: pytest.MonkeyPatch) -> None:
    """The gate does not know that the tree is ending, and it counts the first confirmed stop as final."""
    patch.setattr(failsafe, "ENDING_REASONS", frozenset())
    patch.setattr(WireProcess, "ended_safe", True)
    patch.setattr(WireProcess, "close_link", lambda self: self.process.kill())


def a_hold_takes_readings_of_any_age(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(ServoSession, "recent_positions", lambda self: dict(self.readings.counts))


def a_goal_goes_to_motors_without_torque(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(ServoSession, "reachable_goals", lambda self, counts: dict(counts))


def a_stop_of_a_task_beside_a_dead_wire_ends_the_root(patch: pytest.MonkeyPatch) -> None:
    async def hold(self: Tasks) -> str:
        await self._gate.ask(Stop(Reason.POLICY, "the task was stopped"), 0.3)
        return ""

    async def told(self: process.Tree, cell: Any, task_status: Any = trio.TASK_STATUS_IGNORED) -> None:
        try:
            await cell.run(task_status)
        except Exception:
            process.os._exit(1)

    patch.setattr(Tasks, "_hold", hold)
    patch.setattr(process.Tree, "_run_actor", told)


def a_task_begins_after_its_deadline(patch: pytest.MonkeyPatch) -> None:
    """The root does not check the deadline, and the requester does not cancel."""
    patch.setattr(Tasks, "_refuse_late", lambda self, message: None)
    patch.setattr(Rollouts, "_never_started", _no_answer)
    init = Tasks.__init__

    def forgetful(self: Tasks, robot: str, start: Any, *others: Any, **named: Any) -> None:
        async def without_deadline(entry: str, args: dict[str, Any]) -> Any:
            return await start(entry, {**args, "deadline_ns": 0})

        init(self, robot, without_deadline, *others, **named)

    patch.setattr(Tasks, "__init__", forgetful)


def a_lock_ends_with_the_script(patch: pytest.MonkeyPatch) -> None:
    init = LockKeeper.__init__

    def forgetful(self: LockKeeper, locks: Any) -> None:
        init(self, locks)
        self.initial_operator = self._requested = self._done = ""
        self._kept = Kept("")

    patch.setattr(LockKeeper, "__init__", forgetful)


def a_policy_can_be_the_gate(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(Channel, "speaks_for", lambda self, address: True)
    patch.setattr(Channel, "refuse", lambda self, to, message: None)


def a_velocity_goes_on_that_nobody_names(patch: pytest.MonkeyPatch) -> None:
    """An axis that an action does not name keeps its previous target."""
    patch.setattr(Driver, "parse", _parse_from_the_last)


def _parse_from_the_last(self: Driver, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
    parsed = parse_action(action, self.robot, self.table, self._index, state.target)
    if isinstance(parsed, Refused):
        return parsed
    values, named = parsed
    kept = tuple(value if at in named else state.target[at] for at, value in enumerate(values))
    return Candidate(kept, named)


def nobody_looks_at_the_robot_itself(patch: pytest.MonkeyPatch) -> None:
    """The gate checks the robot's conditions only before a setpoint."""
    patch.setattr(Gate, "_check_conditions", lambda *_, **named: None)


def a_stop_of_a_controller_is_not_read_back(patch: pytest.MonkeyPatch) -> None:
    """A stop counts as confirmed once it is sent."""

    async def stop(control: Any) -> Any:
        control.send(SET_STATE, bytes((STOPPED,)))
        await trio.lowlevel.checkpoint()
        return Outcome(True, True, "")

    patch.setattr("strands_actors.drivers.xarm.wire.stop", stop)
    patch.setattr("strands_actors.drivers.xarm.stop_channel.stop", stop)


SET_STATE, STOPPED = 12, 4


def a_stop_needs_the_connection_of_the_wire(patch: pytest.MonkeyPatch) -> None:
    """The controller accepts one client only, and keeps the connection reserved after that client has died."""

    async def connect(self: Any) -> Any:
        await trio.lowlevel.checkpoint()
        raise WireDown("cannot connect")

    patch.setattr("strands_actors.drivers.xarm.stop_channel.XArmStopChannel.connect", connect)


def legs_are_told_to_let_go_once(patch: pytest.MonkeyPatch) -> None:
    """One sent datagram counts as a received order."""

    async def bring_down(link: Any, safe_state: str, held_by: Any = None) -> tuple[MotorReport, ...]:
        written = link.send(link.safe_frame(False))
        await trio.lowlevel.checkpoint()
        joints = link.model.joints
        return tuple(MotorReport(joint.key, joint.slot, written, True, True, "") for joint in joints)

    patch.setattr("strands_actors.drivers.unitree.wire.bring_down", bring_down)
    patch.setattr("strands_actors.drivers.unitree.stop_channel.bring_down", bring_down)


def the_root_has_not_found_the_legs(patch: pytest.MonkeyPatch) -> None:
    """The root counts its DDS participant as ready as soon as it is open."""

    async def make_safe(self: Any, safe_state: str) -> tuple[MotorReport, ...]:
        await trio.lowlevel.checkpoint()
        return reports(self._config.model, False, "the root has no connection to the robot")  # type: ignore[no-any-return]

    patch.setattr("strands_actors.drivers.unitree.stop_channel.UnitreeStopChannel.make_safe", make_safe)


async def _no_answer(self: Rollouts, tasks: Any, failure: Exception) -> Refused:
    await trio.lowlevel.checkpoint()
    return Refused("no_answer", str(failure), "try again", verb="start_task")


def a_permit_forgets_deadlines(patch: pytest.MonkeyPatch) -> None:
    """The transport writes a setpoint even if it is late."""
    init = transport._Permit.__init__

    def forgetful(self: Any, owner: Transport, epoch: int, deadline_ns: int, *others: Any) -> None:
        init(self, owner, epoch, 0, *others)

    patch.setattr(transport._Permit, "__init__", forgetful)


def nobody_waits_for_what_was_asked_before(patch: pytest.MonkeyPatch) -> None:
    """A stop is confirmed as soon as the robot appears safe, even while it is being armed."""
    patch.setattr(SafetyPage, "unsettled_s", lambda self, now_ns: 0.0)
    patch.setattr(SafetyPage, "is_asking", False)


def a_root_that_does_not_answer_has_stopped_the_robot(patch: pytest.MonkeyPatch) -> None:
    """The caller takes "no answer" for "nothing was running"."""

    async def none(self: TreeProcesses, verb: str, why: object) -> StopResult:
        await trio.lowlevel.checkpoint()
        return Confirmed(NothingRan())

    patch.setattr(TreeProcesses, "_await_note", none)


def a_hold_of_a_lost_robot_is_confirmed(patch: pytest.MonkeyPatch) -> None:
    """The gate writes nothing and reports that no action was needed."""
    transitions = {key: row for key, row in failsafe.TRANSITIONS.items() if key != (Mode.LOST, Event.HOLD)}
    patch.setattr(failsafe, "TRANSITIONS", transitions)
    report_now = Gate._report_now

    def confirmed(self: Gate, reason: Reason) -> StopReport:
        report = report_now(self, reason)
        return msgspec.structs.replace(report, confirmed=True, motors=()) if not report.took_ms else report

    def release(self: Gate, message: Release) -> Released:
        held = self._leases.release(message.lease, message.channel)
        if held is not None:
            self._end_writer(held)
        return Released(True, StopReport(Reason.LEASE, SafeState.HOLD, self._state.epoch, True, ()))

    patch.setattr(Gate, "_report_now", confirmed)
    patch.setattr(Gate, "_release", release)


def a_process_stays_that_cannot_stop_the_robot(patch: pytest.MonkeyPatch) -> None:
    """No file descriptors are held in reserve, and no process checks whether any are left."""
    patch.setattr(Reserve, "begin", lambda self, other_acts: None)


def a_stop_waits_before_its_first_frame(patch: pytest.MonkeyPatch) -> None:
    """No bug of an earlier version. It shows that the explorer sees each wire of its kit."""
    for name in WIRES_OF_THE_KIT:
        wire = load(f"strands_actors.drivers.{name}")
        patch.setattr(wire, "make_safe", _waiting(wire.make_safe))


def answers_move_an_arm_until_its_stop_begins(patch: pytest.MonkeyPatch) -> None:
    """The wire of a KUKA arm answers each message of the controller. Here it does not check before an answer
    whether the setpoint is still permitted. So the arm moves on while the stop waits."""
    a_stop_waits_before_its_first_frame(patch)
    patch.setattr("strands_actors.drivers.kuka.wire.KukaWire._is_live", lambda self: self._permit is not None)


def commands_move_an_arm_until_its_stop_begins(patch: pytest.MonkeyPatch) -> None:
    """The process of a Franka arm brakes it 0.2 s after its last permitted setpoint. Here it does not. So the arm
    moves on while the stop waits."""
    a_stop_waits_before_its_first_frame(patch)
    patch.setattr("strands_actors.drivers.franka.cycle.FEED_S", 10.0)


def _waiting(make_safe: Callable[..., Awaitable[Any]]) -> Callable[..., Awaitable[Any]]:
    async def wait(self: Any, safe_state: SafeState) -> Any:
        await trio.sleep(WAIT_S)
        return await make_safe(self, safe_state)

    return wait

"""Check the invariants that every run must keep.

Each invariant is a function that reads the ``Evidence`` of a run (registers, frames, requests and
answers) and yields the violations. A bound that is promised for a single fault is checked only
where no other fault was near.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from strands_actors.contract.driver import HOLDING_REASONS, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.supervisors.gate.messages import Perform, Resume, Resumed, Setpoint, Stop, StopReport
from strands_actors.supervisors.root.messages import Fence, StartTask

from .conversation import Asked
from .evidence import Evidence

NS = 1e9
LIMP_SEEN_S = 0.08
"""The driver knows after this time that a servo has lost its torque, because it reads each servo
every 33 ms."""
LIMP_KNOWN_S = 0.35
"""The same time after a reset, and where answers are lost."""
DEATH_S = 0.15
FREEZE_S = 0.25
"""Published are 50 ms after a death and 150 ms after a freeze. 100 ms are added, because the
simulated processors run late."""
ORDER_S = 0.3
"""A stop waits for one message on the mesh. It interrupts work that need not be finished."""
HELD_S = 0.15
"""From the success of a verb that ends a motion until the robot holds."""
WRITER_S = 1.3
"""A writer that is dead or frozen for so long has lost its lease (1 s)."""
CONDITION_S = 0.4
"""Within this time the tree acts on a condition, which the driver reads at its control rate."""
START_S = 1.1
"""Within this time the sender of a request for a task learns that the task was not started."""


EXHAUSTED_S = 0.6
"""Two bounds of a freeze. An exhausted process notices this at its first attempt and ends, and then
the next process acts."""


class Violation(NamedTuple):
    """A violation of an invariant.

    Attributes:
        invariant: Name of the invariant, the same for every run that violates it.
    """

    invariant: str
    t_s: float
    detail: str


Found = Iterator[tuple[float, str]]


def no_setpoint_past_its_deadline(seen: Evidence) -> Found:
    written: set[int] = set()
    for frame, asked in seen.setpoints():
        assert isinstance(asked.message, Setpoint)
        late_s = frame.left_s - asked.message.deadline_ns / NS
        if late_s > 1e-6 and not (asked.message.latched and id(asked) in written):
            yield frame.t_s, f"{late_s * 1e3:.2f} ms past its deadline"
        written.add(id(asked))


def no_setpoint_after_a_safe_frame(seen: Evidence) -> Found:
    """A hold counts from its first frame, because a setpoint that is requested while the hold is being
    confirmed belongs to the new epoch."""
    asked_for = {id(frame): asked for frame, asked in seen.setpoints()}
    holding = seen.safe_states(*HOLDING_REASONS)
    safe_s = float("-inf")
    holds = False
    for frame in sorted(seen.frames, key=lambda frame: frame.left_s):
        if frame.kind == "setpoint":
            holds = False
            asked = asked_for.get(id(frame))
            if asked is not None and asked.at_s < safe_s:
                yield frame.t_s, f"asked for at {seen.s(asked.at_s)}, safe frame at {seen.s(safe_s)}"
        elif frame.safe_state and seen.counts(frame) and not (holds and frame.safe_state in holding):
            safe_s = frame.left_s
            holds = frame.safe_state in holding


def nothing_is_executed_that_was_refused(seen: Evidence) -> Found:
    for frame, asked in seen.setpoints():
        if asked.refused and asked.answered_s < frame.left_s:
            yield frame.t_s, f"a setpoint refused at {seen.s(asked.answered_s)}: {asked.answer}"


def every_setpoint_was_asked_for(seen: Evidence) -> Found:
    for frame in seen.unknown():
        yield frame.t_s, f"{frame.role} writes goals that nobody asked for: {dict(frame.goals)}"


def what_is_not_named_rests(seen: Evidence) -> Found:
    """A velocity that an action does not name rests. A position that it does not name keeps its goal."""
    for frame, asked in seen.setpoints():
        assert isinstance(asked.message, Setpoint)
        named = {seen.model.told(key, value)[0] for key, value in asked.message.action.items()}
        for motor, rest in seen.model.rest.items():
            if motor not in named and frame.goals.get(motor, rest) != rest:
                yield frame.t_s, f"nobody asked motor {motor} for {frame.goals[motor]}"


def a_condition_is_obeyed(seen: Evidence) -> Found:
    ends = seen.first_states(Reason.STOP, Reason.ESTOP)
    for fault in seen.lone_conditions():
        end_s = fault.t_s + CONDITION_S
        if fault.for_s < CONDITION_S or not seen.energised_at(fault.t_s) or not seen.energised_at(end_s):
            continue
        if not seen.ends_by(end_s) and not any(
            frame.safe_state in ends and fault.t_s < frame.t_s <= end_s for frame in seen.frames
        ):
            yield end_s, f"{fault.kind} since {seen.s(fault.t_s)}, and it still flies"


def no_task_begins_that_failed_to_start(seen: Evidence) -> Found:
    starts = [asked for asked in seen.asked if isinstance(asked.message, StartTask)]
    for frame, asked in seen.setpoints():
        if asked.who != "policy":
            continue
        began = [start for start in starts if start.at_s < asked.at_s]
        in_time = any(
            (not start.refused and start.answered_s - start.at_s < START_S) or frame.left_s - start.at_s < START_S
            for start in began
        )
        if not in_time:
            yield frame.t_s, "a policy moves the robot though its start was refused, or not answered in time"


def a_hold_moves_no_joint(seen: Evidence) -> Found:
    for frame in seen.frames:
        if frame.kind != "safe":
            continue
        for motor, goal in frame.goals.items():
            if motor not in frame.energised_before:
                continue
            low, high = seen.model.held_between(motor, frame)
            if not low <= goal <= high:
                here = f"at {frame.positions[motor]} with goal {frame.before[motor]}"
                detail = f"motor {motor} {here} is told to hold at {goal}"
                yield frame.t_s, detail


def no_frame_energises_a_limp_motor(seen: Evidence) -> Found:
    if not seen.model.KEEPS_TORQUE_BY_RESUME:
        return
    for frame in seen.frames:
        if frame.kind not in ("setpoint", "lowering") and frame.safe_state != "hold":
            continue
        for motor in frame.energised - frame.energised_before:
            since_s = seen.limp_since(motor, frame.t_s)
            known_s = LIMP_SEEN_S if seen.heard(since_s - LIMP_KNOWN_S, frame.t_s) else LIMP_KNOWN_S
            if frame.t_s - since_s > known_s:
                yield frame.t_s, f"{frame.kind} energises motor {motor}, limp since {seen.s(since_s)}"


def what_is_confirmed_is_so(seen: Evidence) -> Found:
    ends = seen.safe_states(Reason.STOP, Reason.ESTOP)
    for asked in seen.asked:
        report = asked.answer
        if not isinstance(report, StopReport) or not report.confirmed or report.safe_state not in ends:
            continue
        at_s = report.at_ns / NS if report.motors else asked.answered_s
        if on := seen.energised_at(at_s):
            yield at_s, f"{asked.who} is told that all motors are safe, motors {sorted(on)} are energised"


def a_lock_is_obeyed(seen: Evidence) -> Found:
    for asked in seen.asked:
        locks = isinstance(asked.message, Stop | Fence) and asked.message.lock
        if not locks or not isinstance(asked.answer, StopReport):
            continue
        lifted_s = min((lift.at_s for lift in _lifts(seen, asked)), default=float("inf"))
        before: frozenset[int] = seen.energised_at(asked.answered_s)
        for t_s, motors in seen.energised_log:
            if asked.answered_s < t_s < lifted_s and motors - before:
                yield t_s, f"motors {sorted(motors - before)} energised under the lock of {seen.s(asked.at_s)}"
            before = motors if t_s > asked.answered_s else before
        for frame, _ in seen.setpoints():
            if asked.answered_s < frame.left_s < lifted_s:
                yield frame.t_s, f"a setpoint under the lock of {seen.s(asked.at_s)}"


def _lifts(seen: Evidence, locked: Asked) -> Iterator[Asked]:
    for asked in seen.asked:
        lifts = isinstance(asked.message, Resume) and asked.message.lift and asked.who != "policy"
        if lifts and asked.answered_s > locked.at_s:
            yield asked


def a_death_is_followed_by_a_safe_frame(seen: Evidence) -> Found:
    for fault in seen.lone_faults():
        bound_s = DEATH_S if fault.kind == "kill" else FREEZE_S
        if not seen.energised_at(fault.t_s) or (fault.kind == "freeze" and fault.for_s < bound_s):
            continue
        end_s = fault.t_s + bound_s
        safe = not seen.energised_at(end_s) or seen.ends_by(end_s)
        if not safe and not any(frame.safe_state and fault.t_s < frame.t_s <= end_s for frame in seen.frames):
            yield end_s, f"{fault.kind} of {fault.who} at {seen.s(fault.t_s)}: no safe frame within {bound_s} s"


def nothing_is_energised_without_a_resume(seen: Evidence) -> Found:
    """A motor is energised only after a resume or a service, and not by a policy.

    A servo that gets its torque back by a goal is not checked here. A request that was
    cut off may take effect for as long as the driver declares. SAF-021 checks this.
    """
    may_energise = Resume | Perform
    asks = [asked for asked in seen.asked if isinstance(asked.message, may_energise) and asked.who != "policy"]
    late_s = seen.model.driver.late_s
    for frame in seen.frames:
        arms = frame.kind == "enable" or (frame.kind == "safe" and not frame.safe_state)
        if not arms or not frame.energised - frame.energised_before:
            continue
        if not any(asked.at_s <= frame.left_s <= asked.answered_s + late_s for asked in asks):
            yield (
                frame.t_s,
                f"motors {sorted(frame.energised - frame.energised_before)} are energised, nobody resumes",
            )


def an_order_to_stop_is_written(seen: Evidence) -> Found:
    ends = seen.first_states(Reason.STOP, Reason.ESTOP)
    for asked in seen.orders():
        end_s = asked.at_s + ORDER_S
        if not seen.energised_at(asked.at_s) or not seen.energised_at(end_s) or end_s > seen.end_s:
            continue
        if seen.ends_by(asked.at_s):
            continue
        if not any(frame.safe_state in ends and asked.at_s < frame.t_s <= end_s for frame in seen.frames):
            yield end_s, f"{asked.who} says stop at {seen.s(asked.at_s)}: no safe frame within {ORDER_S} s"


def no_process_fails_by_itself(seen: Evidence) -> Found:
    for process in seen.failed():
        yield process.until_s, f"{process.role} ends with code {process.code}"


def no_writer_outlives_its_lease(seen: Evidence) -> Found:
    for frame, asked in seen.setpoints():
        gone_s = seen.gone_since(asked.pid, frame.left_s)
        if frame.left_s - gone_s > WRITER_S:
            yield frame.t_s, f"{asked.who} is dead or frozen since {seen.s(gone_s)}, its setpoint is re-sent"


def nothing_stays_energised(seen: Evidence) -> Found:
    if seen.energised_at(float("inf")) and not seen.excused:
        left = ", ".join(seen.alive()) or "no process"
        yield seen.end_s, f"motors {sorted(seen.energised_at(float('inf')))} have torque, {left} is left"


def an_estop_is_carried_out_as_ordered(seen: Evidence) -> Found:
    """Any process may carry out an e-stop, at any time, but not to a milder state for another fault.

    This holds until the e-stop is confirmed, a resume succeeds, or another tree begins.
    """
    wanted = SafeState(next(iter(seen.safe_states(Reason.ESTOP))))
    resumes = [asked.answered_s for asked in seen.asked if isinstance(asked.answer, Resumed)]
    roots = [process.began_s for process in seen.world.processes if process.role == "root"]
    for asked in seen.asked:
        report = asked.answer
        if not isinstance(asked.message, Stop | Fence) or asked.message.reason is not Reason.ESTOP:
            continue
        if not isinstance(report, StopReport):
            continue
        state: str | None = report.safe_state
        if not report.confirmed:
            until_s = min((t_s for t_s in (*resumes, *roots) if t_s > asked.answered_s), default=float("inf"))
            safe = (
                frame.safe_state
                for frame in seen.frames
                if frame.safe_state and asked.answered_s < frame.left_s < until_s and seen.counts(frame)
            )
            state = next(safe, None)
        if state is not None and not SafeState(state).at_least(wanted):
            yield asked.answered_s, f"an e-stop to {wanted} is carried out as {state}"


def a_tree_ends(seen: Evidence) -> Found:
    if left := seen.alive():
        yield seen.end_s, f"{', '.join(left)} still runs after its caller"


def a_death_beside_an_exhausted_process_is_followed_by_a_safe_frame(seen: Evidence) -> Found:
    for fault in seen.faults_beside_exhaustion():
        end_s = fault.t_s + EXHAUSTED_S
        if not seen.energised_at(fault.t_s) or (fault.kind == "freeze" and fault.for_s < EXHAUSTED_S):
            continue
        safe = not seen.energised_at(end_s) or seen.ends_by(end_s)
        if not safe and not any(frame.safe_state and fault.t_s < frame.t_s <= end_s for frame in seen.frames):
            yield end_s, f"{fault.kind} of {fault.who} at {seen.s(fault.t_s)}: no safe frame within {EXHAUSTED_S} s"


def nothing_takes_effect_after_a_confirmed_stop(seen: Evidence) -> Found:
    """A request from before a stop energises no motor after the report of the stop."""
    ends = seen.safe_states(Reason.STOP, Reason.ESTOP)
    asks = [asked for asked in seen.asked if isinstance(asked.message, Resume | Perform) and asked.who != "policy"]
    asks += [asked for _, asked in seen.setpoints()]  # of a robot that a setpoint energises
    for asked in seen.asked:
        report = asked.answer
        if not isinstance(report, StopReport) or not report.confirmed or report.safe_state not in ends:
            continue
        for t_s, motors in seen.energising():
            newer = any(asked.at_s < other.at_s <= t_s for other in asks)
            if t_s > asked.answered_s and not newer:
                told = f"{asked.who} is told at {seen.s(asked.answered_s)} that all motors are safe"
                yield t_s, f"{told}, then motors {sorted(motors)} are energised, by what was asked before"


def a_success_is_true(seen: Evidence) -> Found:
    """After a successful stop no motor is energised. After a successful end of a motion that motion
    has ended."""
    for told in seen.told:
        if not told.success or not seen.energised_at(told.answered_s):
            continue
        if told.verb in ("stop", "estop", "cleanup"):
            since_s = told.asked_s
            others = any(
                isinstance(asked.message, Resume | Perform) and since_s < asked.answered_s
                for asked in seen.asked
                if asked.at_s <= told.answered_s
            )
            if not others:
                yield told.answered_s, f"{told.verb}: success, motors are energised, nobody has resumed"
        elif told.verb in ("release", "stop_task"):
            end_s = told.answered_s + HELD_S
            frame = seen.last_order(end_s)
            if frame is not None and seen.is_moved_by(frame, told) and seen.energised_at(end_s):
                yield end_s, f"{told.verb}: success, the setpoint of {seen.s(frame.t_s)} stands"


INVARIANTS: dict[str, Callable[[Evidence], Found]] = {
    "SAF-001 no setpoint past its deadline": no_setpoint_past_its_deadline,
    "SAF-002 no setpoint after a safe frame": no_setpoint_after_a_safe_frame,
    "SAF-003 a death is followed by a safe frame": a_death_is_followed_by_a_safe_frame,
    "SAF-003 a condition is obeyed": a_condition_is_obeyed,
    "SAF-003 no process fails by itself": no_process_fails_by_itself,
    "SAF-004 no writer outlives its lease": no_writer_outlives_its_lease,
    "SAF-005 what is confirmed is so": what_is_confirmed_is_so,
    "SAF-007 an e-stop is carried out as ordered": an_estop_is_carried_out_as_ordered,
    "SAF-008 nothing is energised without a resume": nothing_is_energised_without_a_resume,
    "SAF-010 nothing is executed that was refused": nothing_is_executed_that_was_refused,
    "SAF-010 no task begins that failed to start": no_task_begins_that_failed_to_start,
    "SAF-014 every setpoint was asked for": every_setpoint_was_asked_for,
    "SAF-014 what is not named rests": what_is_not_named_rests,
    "SAF-015 a tree ends": a_tree_ends,
    "SAF-018 a lock is obeyed": a_lock_is_obeyed,
    "SAF-018 nothing stays energised": nothing_stays_energised,
    "SAF-020 an order to stop is written": an_order_to_stop_is_written,
    "SAF-021 nothing takes effect after a stop": nothing_takes_effect_after_a_confirmed_stop,
    "SAF-023 a success is true": a_success_is_true,
    "SAF-024 an exhausted process is no obstacle": (
        a_death_beside_an_exhausted_process_is_followed_by_a_safe_frame
    ),
    "SAF-019 a hold moves no joint": a_hold_moves_no_joint,
    "SAF-019 no frame energises a limp motor": no_frame_energises_a_limp_motor,
}


def violations_of(seen: Evidence) -> tuple[Violation, ...]:
    """Return the first violation of each invariant, in the order of time."""
    found = []
    for name, check in INVARIANTS.items():
        first = next(check(seen), None)
        if first is not None:
            found.append(Violation(name, *first))
    return tuple(sorted(found, key=lambda violation: violation.t_s))

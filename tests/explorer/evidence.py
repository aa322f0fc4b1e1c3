"""Collect the evidence of a run, which its invariants check."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.supervisors.gate.messages import Setpoint, Stop

from .conversation import Asked, Conversation, Told
from .kinds import AT_A_POINT, BUS, CALLER, CONDITIONS, EXHAUSTION, NETWORK, PEER, PEER_TALKS, SERVICE, SESSION
from .robot_model import Frame, RobotModel
from .world import TREE, Process, World

ALONE_S = 0.35
"""The bound of a fault is promised if there was no other fault from this time before it until the
end of the bound."""


class Fault(NamedTuple):
    t_s: float
    kind: str
    who: str
    for_s: float


class Evidence:
    """The frames, requests, answers and faults of a run.

    Attributes:
        mended_s: All faults are undone from this time on.
    """

    def __init__(self, world: World, model: RobotModel, mended_s: float) -> None:
        self.world = world
        self.model = model
        self.frames = model.frames
        self.energised_log = model.energised_log
        self.energised_at = model.energised_at
        self.end_s = world.now_s
        self.mended_s = mended_s
        self._conversation: Conversation = world.conversation

    def s(self, t_s: float) -> str:
        """Return a time as text, counted from the beginning of the run."""
        return f"{t_s - self.world.began_s:.4f} s"

    def safe_states(self, *reasons: Reason) -> frozenset[str]:
        """Return the safe states of the robot for these reasons."""
        return frozenset(str(self.model.driver.fallbacks[reason]) for reason in reasons)

    def first_states(self, *reasons: Reason) -> frozenset[str]:
        """Return the safe states that the first frame for these reasons may have. An arm that is lowered holds
        first."""
        states = self.safe_states(*reasons)
        return states | {"hold"} if SafeState.LOWERED in states else states

    def ends_by(self, t_s: float) -> bool:
        """Return whether the robot is finishing by itself, as a drone that lands.

        Its last frame then carries a safe state of a stop.
        """
        last = next((frame for frame in reversed(self.frames) if frame.t_s <= t_s), None)
        return last is not None and last.safe_state in self.safe_states(Reason.STOP, Reason.ESTOP)

    @property
    def asked(self) -> list[Asked]:
        return self._conversation.asked

    @property
    def told(self) -> list[Told]:
        """Return the envelopes of the script's verbs."""
        return self._conversation.told

    def energising(self) -> Iterator[tuple[float, frozenset[int]]]:
        """Yield the times when motors were energised, and these motors."""
        before: frozenset[int] = frozenset()
        for t_s, motors in self.energised_log:
            if motors - before:
                yield t_s, motors - before
            before = motors

    # -- setpoints on the wire, and their requests

    def setpoints(self) -> Iterator[tuple[Frame, Asked]]:
        yield from ((frame, asked) for frame, asked in self._setpoints if asked is not None)

    def unknown(self) -> Iterator[Frame]:
        yield from (frame for frame, asked in self._setpoints if asked is None)

    @cached_property
    def _setpoints(self) -> list[tuple[Frame, Asked | None]]:
        """Each setpoint on the wire with its request; None if no request fits.

        A request is recognised by the marked value of its wrist. If the frame does not write that
        axis, all goals of the frame are compared.
        """
        marked: dict[tuple[int, float], Asked] = {}
        goals: list[tuple[Asked, dict[int, float]]] = []
        for asked in self._conversation.setpoints:
            assert isinstance(asked.message, Setpoint)
            action = {name: self.model.told(name, value) for name, value in asked.message.action.items()}
            marked |= {mark: asked for name, mark in action.items() if self.model.marks(name)}
            goals.append((asked, dict(action.values())))
        motors = {motor for motor, _ in marked}
        found: list[tuple[Frame, Asked | None]] = []
        for frame in self.frames:
            if frame.kind != "setpoint":
                continue
            marks = [mark for mark in frame.goals.items() if mark[0] in motors]
            if marks:
                found.append((frame, next((marked[mark] for mark in marks if mark in marked), None)))
            elif (asked_for := _last_that_fits(frame, goals)) is not None:
                found.append((frame, asked_for))
        return found

    def last_order(self, t_s: float) -> Frame | None:
        """Return the last setpoint or safe frame of the robot until this time."""
        orders = (frame for frame in reversed(self.frames) if frame.t_s <= t_s and frame.kind != "enable")
        return next(orders, None)

    def is_moved_by(self, frame: Frame, told: Told) -> bool:
        """Return whether the verb should have ended this setpoint.

        It should if a policy requested the setpoint before the verb. A release also ends the
        setpoints of the script itself.
        """
        writers = ("policy",) if told.verb == "stop_task" else (CALLER, "policy")
        return any(
            each is frame and asked.at_s < told.asked_s and asked.who in writers for each, asked in self.setpoints()
        )

    def counts(self, frame: Frame) -> bool:
        """Return whether the writer of this frame could know that it is the only writer.

        The wire process always knows it. Another process knows it when the wire process has ended.
        """
        return frame.role == "wire" or not self._wire_lives(frame.left_s)

    def limp_since(self, motor: int, t_s: float) -> float:
        """Return when a motor that gets its torque back at ``t_s`` had lost it."""
        since_s = self.world.began_s
        had = False
        for at_s, motors in self.energised_log:
            if at_s >= t_s:
                break
            if had and motor not in motors:
                since_s = at_s
            had = motor in motors
        return since_s

    # -- faults

    @cached_property
    def faults(self) -> list[Fault]:
        return [
            Fault(t_s, event.kind, event.who, event.value or self.mended_s - t_s)
            for t_s, event in self.world.befell
            if event.kind in _WRONG
        ]

    def heard(self, from_s: float, to_s: float) -> bool:
        """Return whether the bus had no fault in this time. A servo that protects itself is no fault."""
        troubles = [fault for fault in self.faults if fault.kind not in ("unload", "restart")]
        return not any(fault.t_s < to_s and from_s < fault.t_s + _lasts_s(fault) + 0.2 for fault in troubles)

    def lone_faults(self) -> Iterator[Fault]:
        """Yield each kill or freeze of caller, root or wire that has no other fault near it."""
        for fault in self.faults:
            if fault.kind not in ("kill", "freeze") or fault.who not in ("caller", "root", "wire"):
                continue
            if fault.kind == "freeze" and fault.who == "caller":
                continue  # A frozen caller leads to a hold only if it had commanded a motion.
            if self._is_alone(fault):
                yield fault

    def faults_beside_exhaustion(self) -> Iterator[Fault]:
        """Yield each kill or freeze of caller, root or wire while another process is exhausted.

        There is no further fault near it.
        """
        for fault in self.faults:
            if fault.kind not in ("kill", "freeze") or fault.who not in ("caller", "root", "wire"):
                continue
            if fault.kind == "freeze" and fault.who == "caller":
                continue
            near = [other for other in self.faults if other is not fault and _near(fault.t_s, other)]
            lacking = [other for other in near if other.kind in EXHAUSTION and other.who != fault.who]
            if lacking and len(lacking) == len(near) and all(other.t_s <= fault.t_s for other in lacking):
                yield fault

    def lone_conditions(self) -> Iterator[Fault]:
        """Yield each condition of the robot itself that has no other fault near it."""
        yield from (fault for fault in self.faults if fault.kind in CONDITIONS and self._is_alone(fault))

    def _is_alone(self, fault: Fault) -> bool:
        return not any(other is not fault and _near(fault.t_s, other) for other in self.faults)

    @property
    def excused(self) -> bool:
        """Return whether the plan killed the last process that could have made the robot safe."""
        able = [process for process in self.world.processes if process.role in ("root", "wire", "standby")]
        last = max(able, key=lambda process: process.until_s, default=None)
        return last is not None and last.by_plan

    def _wire_lives(self, t_s: float) -> bool:
        return any(
            process.role == "wire" and process.began_s <= t_s < process.until_s for process in self.world.processes
        )

    def gone_since(self, pid: int, t_s: float) -> float:
        """Return since when a process is dead or frozen at ``t_s``; ``t_s`` itself if it is neither."""
        process = self.world.by_pid(pid)
        assert process is not None
        if process.until_s <= t_s:
            return process.until_s
        return next((begin_s for begin_s, end_s in process.frozen_times if begin_s <= t_s < end_s), t_s)

    def orders(self) -> Iterator[Asked]:
        """Yield the stops that no fault keeps from the robot.

        The robot can be written to, and every process that passes the stop on is alive, not frozen
        and not late.
        """
        for asked in self.asked:
            orders = isinstance(asked.message, Stop) and asked.message.reason in (Reason.STOP, Reason.ESTOP)
            if orders and not any(fault.kind in _DEAF and _near(asked.at_s, fault) for fault in self.faults):
                yield asked

    def failed(self) -> list[Process]:
        """Return the processes of the tree that failed without being exhausted."""
        return [
            process
            for process in self.world.processes
            if process.role in TREE and process.code == 1 and not process.resources.lacked
        ]

    def alive(self) -> list[str]:
        ours = TREE - {"caller"}
        return [process.role for process in self.world.processes if process.role in ours and process.left_over]


_WRONG = frozenset(
    {
        "kill",
        "freeze",
        "lag",
        "restart",
        "cut mesh",
        "slow mesh",
        *BUS,
        *SESSION,
        *NETWORK,
        *SERVICE,
        *CONDITIONS,
        *PEER,
        *EXHAUSTION,
    }
)
_STILL_HEARS = (
    *("lose replies", "hold replies", "mute", "late", "corrupt", "garble", "twice", "slow service"),
    *PEER_TALKS,
    *AT_A_POINT,
    *CONDITIONS,
)
_DEAF = _WRONG - {*_STILL_HEARS}


def _last_that_fits(frame: Frame, goals: list[tuple[Asked, dict[int, float]]]) -> Asked | None:
    for asked, told in reversed(goals):
        named = told.keys() & frame.goals.keys()
        if asked.at_s <= frame.t_s and named and all(told[motor] == frame.goals[motor] for motor in named):
            return asked
    return None


def _near(t_s: float, fault: Fault) -> bool:
    return fault.t_s < t_s + ALONE_S and t_s - ALONE_S < fault.t_s + _lasts_s(fault)


def _lasts_s(fault: Fault) -> float:
    return 0.0 if fault.kind in AT_A_POINT else fault.for_s if fault.kind != "kill" else 0.5

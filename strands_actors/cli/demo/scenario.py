"""What happens in the demo, in order: move, break a process, look at the wire, resume, move again."""

from __future__ import annotations

import itertools
import os
import signal
import statistics
import time
from collections.abc import Callable
from typing import Any

import msgspec

from ...robot import RealRobot
from ...runtime.clock import NS
from ...runtime.contract import Reason
from ...supervisors.watchdog import BEAT_TTL_S
from .watch import Watch, status_of, wait_for

CONTROL_HZ = 50.0
MOTION: dict[str, Any] = {"amplitude": 11.0, "hz": 0.4, "spread": 0.12}
READY = {
    "shoulder_pan": 0.0,
    "shoulder_lift": -8.0,
    "elbow_flex": 8.0,
    "wrist_flex": 0.0,
    "wrist_roll": 0.0,
    "gripper": 45.0,
}
"""Commanded before each rollout: a limp arm has sunk, and a sine needs room on both sides."""

LOOK_S = 3.0
"""How long the wire is searched for a safe frame, far past every bound."""
RESTART_S = 15.0
"""For processes to start on a busy machine."""


class Fault(msgspec.Struct, frozen=True):
    victim: str
    signal: str
    reason: Reason  # as which the tree sees it: the driver's ladder has the rung
    freezes: bool = False
    """A death is seen at once. A freeze shows only by silence, as long as a beat may be late."""

    def bound_ms(self, bound_s: float) -> float:
        return round(1e3 * (bound_s + (BEAT_TTL_S if self.freezes else 0.0)), 3)


FAULTS = (
    Fault("policy", "SIGKILL", Reason.POLICY),
    Fault("wire", "SIGKILL", Reason.WIRE),
    Fault("root", "SIGSTOP", Reason.ROOT, freezes=True),
)


class Outcome(msgspec.Struct):
    """What one fault did, by the wire's log."""

    victim: str
    signal: str
    pid: int
    rung: str
    bound_ms: float
    struck_ns: int
    safe_ns: int | None = None
    resumed_ns: int | None = None
    setpoints_after: int = 0
    watched_s: float = 0.0
    restarted: bool = False
    rearmed: bool = False
    detail: str = ""

    @property
    def safe_after_ms(self) -> float | None:
        return None if self.safe_ns is None else (self.safe_ns - self.struck_ns) / 1e6

    @property
    def in_time(self) -> bool:
        after_ms = self.safe_after_ms
        return after_ms is not None and after_ms <= self.bound_ms

    @property
    def safe(self) -> bool:
        return self.in_time and not self.setpoints_after and self.restarted and self.rearmed and not self.detail


class Pace(msgspec.Struct):
    """How steadily the policy ran, undisturbed."""

    policy_hz: float
    setpoints_per_s: float  # on the wire: the policy's, and those re-sent between them
    gap_ms_median: float
    gap_ms_p99: float
    gap_ms_max: float


class Failed(Exception):
    """The demo cannot go on. The text says why."""


class Scenario:
    """``note(text, kind)`` hears what happens: kinds are plain, good, bad and fault."""

    def __init__(self, robot: RealRobot, watch: Watch, bound_s: float, note: Callable[[str, str], None]) -> None:
        self.outcomes: list[Outcome] = []
        self.pace: Pace | None = None
        self.phase = "starting"
        self._robot = robot
        self._watch = watch
        self._bound_s = bound_s
        self._note = note
        self._ladder: dict[str, str] = {}

    def start(self) -> None:
        began = time.monotonic()
        self.phase = "starting the twin and its tree"
        problem = self._robot.connect_eagerly()
        if problem is not None:
            raise Failed(problem)
        self._watch.start()
        wait_for(lambda: "ladder" in self._status(), RESTART_S)
        self._ladder = self._status()["ladder"]
        self._note(f"twin and tree up in {time.monotonic() - began:.1f} s, armed where it stands", "good")

    def run(self, seconds: float, faults: tuple[Fault, ...]) -> None:
        """Moving takes twice as long as looking at what was made safe."""
        look_s = seconds / (3 * len(faults) + 2)
        self._move("a sine policy runs")
        began_ns = time.monotonic_ns()
        self._let_move(2 * look_s)
        self.pace = self._measure_pace(began_ns)
        for number, fault in enumerate(faults, 1):
            self.phase = f"fault {number} of {len(faults)}: {fault.signal} {fault.victim}"
            self._break(fault, look_s)
            self._let_move(2 * look_s)
        self.phase = "done"

    # -- moving

    def _move(self, what: str) -> None:
        """Start the rollout; return when its first setpoint was on the wire."""
        deadline = time.monotonic() + RESTART_S
        self._command(lambda: self._robot.send_action(READY), "move", deadline)
        self._command(self._start_task, "start_task", deadline)
        if not wait_for(lambda: self._task()["steps"] > 0, RESTART_S):
            raise Failed(f"the policy sent nothing within {RESTART_S:g} s{self._why_ended()}")
        wait_for(lambda: self._watch.pid("policy") is not None, RESTART_S)
        self._note(f"{what} at {CONTROL_HZ:g} Hz, process {self._watch.pid('policy')}", "plain")

    def _start_task(self) -> dict[str, Any]:
        return self._robot.start_task(
            "wave", policy_provider="sine", duration=3600.0, control_frequency=CONTROL_HZ, **MOTION
        )

    def _command(self, verb: Callable[[], dict[str, Any]], name: str, deadline: float) -> None:
        """Until it is accepted: a policy whose gate has died takes a moment to end by itself."""
        while True:
            answer = verb()
            if answer["status"] == "success":
                return
            refusal = answer["content"][-1].get("json", {}).get("refused", {}).get("code")
            if refusal != "running" or time.monotonic() > deadline:
                raise Failed(f"{name}: {answer['content'][0]['text']}")
            time.sleep(0.02)

    def _let_move(self, seconds: float) -> None:
        self.phase = "moving"
        time.sleep(seconds)
        if not self._task()["running"]:
            raise Failed(f"the policy ended by itself{self._why_ended()}")

    def _task(self) -> dict[str, Any]:
        task: dict[str, Any] = self._robot.get_task_status()["content"][0]["json"]
        return task

    def _why_ended(self) -> str:
        task = self._task()
        return f": {task['exit_reason']}: {task['exit_detail']}" if task["exit_reason"] else ""

    def _measure_pace(self, began_ns: int) -> Pace:
        now_ns = time.monotonic_ns()
        self._watch.wire.poll()
        times = self._watch.wire.setpoint_times_ns(began_ns, now_ns)
        gaps_ms = sorted((later - t) / 1e6 for t, later in itertools.pairwise(times)) or [0.0]
        return Pace(
            policy_hz=self._task()["hz"],
            setpoints_per_s=len(times) / ((now_ns - began_ns) / NS),
            gap_ms_median=statistics.median(gaps_ms),
            gap_ms_p99=gaps_ms[int(0.99 * (len(gaps_ms) - 1))],
            gap_ms_max=gaps_ms[-1],
        )

    # -- breaking

    def _break(self, fault: Fault, look_s: float) -> None:
        watch, wire = self._watch, self._watch.wire
        pid = watch.pid(fault.victim)
        if pid is None:
            raise Failed(f"there is no {fault.victim} process to break")
        rung = self._ladder[fault.reason]
        struck_ns = time.monotonic_ns()
        os.kill(pid, getattr(signal, fault.signal))
        outcome = Outcome(fault.victim, fault.signal, pid, rung, fault.bound_ms(self._bound_s), struck_ns)
        self.outcomes.append(outcome)
        self._note(f"{fault.signal} to the {fault.victim} process ({pid})", "fault")

        def is_safe() -> bool:
            wire.poll()
            return wire.first("safe", struck_ns) is not None

        if wait_for(is_safe, LOOK_S):
            index = wire.first("safe", struck_ns)
            assert index is not None
            outcome.safe_ns = wire.frames[index].t_ns
            late = "" if outcome.in_time else " TOO LATE"
            self._note(
                f"{rung} on the wire after {outcome.safe_after_ms:.1f} ms (bound {outcome.bound_ms:.0f} ms){late}",
                "good" if outcome.in_time else "bad",
            )
            time.sleep(look_s)
            outcome.resumed_ns = time.monotonic_ns()
            wire.poll()
            outcome.setpoints_after = wire.setpoints_behind(index, outcome.resumed_ns)
            outcome.watched_s = (outcome.resumed_ns - outcome.safe_ns) / NS
            self._note(
                f"{outcome.setpoints_after} setpoints in the {outcome.watched_s:.1f} s since",
                "bad" if outcome.setpoints_after else "good",
            )
        else:
            outcome.detail = f"no safe frame within {LOOK_S:g} s"
            self._note(outcome.detail, "bad")
            self._robot.stop()
            outcome.resumed_ns = time.monotonic_ns()
        self._rearm(outcome)

    def _rearm(self, outcome: Outcome) -> None:
        answer = self._robot.resume()
        if answer["status"] != "success":
            outcome.detail = outcome.detail or answer["content"][0]["text"]
            raise Failed(outcome.detail)
        epoch = answer["content"][0]["json"]["epoch"]
        took_ms = (time.monotonic_ns() - (outcome.resumed_ns or 0)) / 1e6
        self._note(f"resume(): armed where it stands, epoch {epoch}, in {took_ms:.0f} ms", "plain")
        energised = self._status().get("energised", {})
        if outcome.victim != "policy" and outcome.rung == "limp" and any(energised.values()):
            # Read back by the new wire process before it armed.
            outcome.detail = f"torque was still on: {', '.join(name for name, on in energised.items() if on)}"
        self._move("a new policy runs")
        outcome.rearmed = True
        outcome.restarted = wait_for(lambda: self._watch.pid(outcome.victim) not in (None, outcome.pid), 5.0)

    def _status(self) -> dict[str, Any]:
        return status_of(self._robot)

"""Carry out the demo: move the arm, break a process, watch what is sent to the arm, resume, move again."""

from __future__ import annotations

import itertools
import os
import signal
import statistics
import time
from collections.abc import Callable
from typing import Any

import msgspec

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.clock import NS

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
"""The pose around which the sine moves. A limp arm has sunk, and the sine needs room on both sides."""

LOOK_S = 3.0
"""How long the wire is watched for a safe frame, in seconds. This is far longer than every bound."""
RESTART_S = 15.0
"""Timeout for processes to start on a busy computer, in seconds."""
TRIES = 4


class Fault(msgspec.Struct, frozen=True):
    victim: str
    signal: str
    # The reason that the robot reports for the stop. The driver declares the safe state for each reason.
    reason: Reason
    freezes: bool = False
    """True if the process is frozen. A death is noticed at once, a freeze only after a heartbeat's timeout."""

    def bound_ms(self, driver: type[Driver]) -> float:
        return round(1e3 * (driver.bound_s + (driver.timing.heartbeat_ttl_s if self.freezes else 0.0)), 3)


FAULTS = (
    Fault("policy", "SIGKILL", Reason.POLICY),
    Fault("wire", "SIGKILL", Reason.WIRE),
    Fault("root", "SIGSTOP", Reason.ROOT, freezes=True),
)


class Outcome(msgspec.Struct):
    """The effect of one fault (a killed or frozen process) on the arm, as the log of the protocol messages to
    the arm shows it."""

    victim: str
    signal: str
    pid: int
    safe_state: str
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
    """How regularly setpoints were sent before the first fault."""

    policy_hz: float
    setpoints_per_s: (
        float  # Setpoints per second that reach the arm. Setpoints that are sent again are counted, too.
    )
    gap_ms_median: float
    gap_ms_p99: float
    gap_ms_max: float


class Failed(Exception):
    """The demo cannot continue. The message is the reason."""


class Scenario:
    """Runs the demo. For each event, ``note(text, kind)`` is called. Kinds are plain, good, bad and fault."""

    def __init__(
        self, robot: RealRobot, watch: Watch, driver: type[Driver], note: Callable[[str, str], None]
    ) -> None:
        self.outcomes: list[Outcome] = []
        self.pace: Pace | None = None
        self.phase = "starting"
        self._robot = robot
        self._watch = watch
        self._driver = driver
        self._note = note
        self._fallbacks: dict[str, str] = {}

    def start(self) -> None:
        began = time.monotonic()
        self.phase = "starting the twin and its tree"
        problem = self._robot.connect_eagerly()
        if problem is not None:
            raise Failed(problem)
        self._watch.start()
        self._fallbacks = self._read("fallbacks")
        self._note(f"twin and tree up in {time.monotonic() - began:.1f} s, armed where it stands", "good")

    def run(self, seconds: float, faults: tuple[Fault, ...]) -> None:
        """Run the demo. The arm moves twice as long before each fault as it is watched after the fault."""
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

    def _move(self, label: str) -> None:
        """Start the policy that moves the arm, and wait until its first setpoint was sent."""
        deadline = time.monotonic() + RESTART_S
        self._insist(self._start_task, deadline)
        wait_for(lambda: self._task()["steps"] > 0 or not self._task()["running"], RESTART_S)
        wait_for(lambda: self._watch.pid("policy") is not None, RESTART_S)
        self._note(f"{label} at {CONTROL_HZ:g} Hz, process {self._watch.pid('policy')}", "plain")

    def _start_task(self) -> dict[str, Any]:
        return self._robot.start_task(
            "wave", policy_provider="sine", duration=3600.0, control_frequency=CONTROL_HZ, center=READY, **MOTION
        )

    def _insist(self, verb: Callable[[], dict[str, Any]], deadline: float) -> dict[str, Any]:
        """Call a method of the robot again and again until the robot accepts it. The robot may refuse it for a
        short time: after its wire process (which writes to the robot) was restarted, until the old policy has
        ended, or while the computer is busy."""
        while (answer := verb())["status"] != "success":
            if time.monotonic() > deadline:
                raise Failed(answer["content"][0]["text"])
            time.sleep(0.02)
        return answer

    def _let_move(self, seconds: float) -> None:
        self.phase = "moving"
        for _ in range(TRIES):
            time.sleep(seconds)
            task = self._task()
            if task["running"] and task["steps"]:
                return
            # On a busy computer the policy may end, because setpoints are refused when readings are too old.
            self._note(f"the policy ended by itself: {task['exit_detail']}", "bad")
            self._insist(self._robot.resume, time.monotonic() + RESTART_S)
            self._move("it is started again")
        raise Failed("the policy does not keep running: is this machine too busy?")

    def _task(self) -> dict[str, Any]:
        task: dict[str, Any] = self._robot.get_task_status()["content"][0]["json"]
        return task

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
        outcome = self._strike(fault)
        if wait_for(lambda: self._first_safe(outcome) is not None, LOOK_S):
            self._look(outcome, look_s)
        else:
            outcome.detail = f"no safe frame within {LOOK_S:g} s"
            self._note(outcome.detail, "bad")
            self._robot.stop()
        self._rearm(outcome)

    def _strike(self, fault: Fault) -> Outcome:
        pid = self._watch.pid(fault.victim)
        if pid is None:
            raise Failed(f"there is no {fault.victim} process to break")
        safe_state, bound_ms = self._fallbacks[fault.reason], fault.bound_ms(self._driver)
        struck_ns = time.monotonic_ns()
        os.kill(pid, getattr(signal, fault.signal))
        outcome = Outcome(fault.victim, fault.signal, pid, safe_state, bound_ms, struck_ns)
        self.outcomes.append(outcome)
        self._note(f"{fault.signal} to the {fault.victim} process ({pid})", "fault")
        return outcome

    def _first_safe(self, outcome: Outcome) -> int | None:
        """Find the first frame (protocol message) after the fault that brings the arm to the safe state. Return
        its index in the log of frames, or None if there is no such frame."""
        self._watch.wire.poll()
        return self._watch.wire.first_safe(outcome.safe_state, outcome.struck_ns)

    def _look(self, outcome: Outcome, look_s: float) -> None:
        """Watch the stopped arm for ``look_s`` seconds. Count the setpoints that were sent after the frame that
        brought the arm to the safe state."""
        wire, index = self._watch.wire, self._first_safe(outcome)
        assert index is not None
        outcome.safe_ns = wire.frames[index].t_ns
        late = "" if outcome.in_time else " TOO LATE"
        self._note(
            f"{outcome.safe_state} on the wire after {outcome.safe_after_ms:.1f} ms "
            f"(bound {outcome.bound_ms:.0f} ms){late}",
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

    def _rearm(self, outcome: Outcome) -> None:
        began_ns = time.monotonic_ns()
        answer = self._insist(self._robot.resume, time.monotonic() + RESTART_S)
        epoch = answer["content"][0]["json"]["epoch"]
        took_ms = (time.monotonic_ns() - began_ns) / 1e6
        self._note(f"resume(): armed where it stands, epoch {epoch}, in {took_ms:.0f} ms", "plain")
        if outcome.safe_state == "limp":
            # The new wire process has read the torque of every servo before it energised the arm.
            energised = [axis for axis, on in self._read("energised").items() if on]
            if energised:
                outcome.detail = f"torque was still on: {', '.join(energised)}"
        self._move("a new policy runs")
        outcome.rearmed = True
        outcome.restarted = wait_for(lambda: self._watch.pid(outcome.victim) not in (None, outcome.pid), 5.0)

    def _read(self, key: str) -> Any:
        """Return a value of the robot's status, by its key. The value is missing while the wire process (which
        reads the robot) does not answer, so wait for the value."""
        deadline = time.monotonic() + RESTART_S
        while key not in (status := status_of(self._robot)):
            if time.monotonic() > deadline:
                raise Failed(f"the status has no {key!r}")
            time.sleep(0.01)
        return status[key]

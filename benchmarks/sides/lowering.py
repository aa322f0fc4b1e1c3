"""``lowering ROBOT END TRIALS``: stop a raised arm again and again, and read its wire log.

ROBOT is an arm that can be lowered. END is ``lower`` or ``limp``, the option ``on_exit``. Each trial is made in
three ways: the script that holds the arm is killed; an e-stop is ordered; a servo falls mute while it is lowered
(only with ``lower``). Script, robot and twin are separate processes.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from typing import TypeVar

from strands_actors.contract.safe_state import SafeState
from strands_actors.testing.bench import Bench, Caller
from strands_actors.testing.registering import LOWERING
from strands_actors.testing.wirelog import Entry

T = TypeVar("T")
PATIENCE_S = 10.0
RESTS_S = 1.2
"""Time after the torque is off until the arm lies still."""
SETTLE_S = 0.3
"""Time after the torque is off in which a setpoint would count."""
MOMENTS_S = (0.1, 0.4, 0.7, 1.0)
"""Times from the begin of a lowering until a servo falls mute."""
MUTE_SERVO = 3


class Figures:
    """The worst figures of all trials of one way."""

    def __init__(self) -> None:
        self.limp_s = 0.0
        self.touch_m_s = 0.0
        self.after = 0

    def add(self, bench: Bench, since_ns: int, limp: Entry) -> None:
        """Add a trial.

        Args:
            bench: The bench.
            since_ns: When the arm was stopped, or its servo fell mute.
            limp: The frame that switched the torque off.
        """
        self.limp_s = max(self.limp_s, (limp.t_ns - since_ns) / 1e9)
        entries = list(bench.log.entries(since_ns))
        touches = (json.loads(entry.data)["speed_m_s"] for entry in entries if entry.kind == "touch")
        self.touch_m_s = max(self.touch_m_s, *touches, 0.0)
        self.after += bench.log.setpoints_after_safe(since_ns)


def limp_frame(bench: Bench, since_ns: int) -> Entry:
    """Wait for the frame that switches the torque of the whole arm off."""

    def found() -> Entry | None:
        frames = bench.log.host("safe", since_ns)
        return next((frame for frame in frames if frame.safe_state == SafeState.LIMP), None)

    return wait_for(found, "the arm is limp")


def wait_for(look: Callable[[], T | None], event: str) -> T:
    deadline_s = time.monotonic() + PATIENCE_S
    while (seen := look()) is None:
        if time.monotonic() > deadline_s:
            raise RuntimeError(f"not within {PATIENCE_S:g} s: {event}")
        time.sleep(0.002)
    return seen


def killed(bench: Bench, caller: Caller, trial: int) -> tuple[int, Entry]:
    began_ns = time.monotonic_ns()
    os.kill(caller.pid("caller"), signal.SIGKILL)
    limp = limp_frame(bench, began_ns)
    return began_ns, limp


def estop(bench: Bench, caller: Caller, trial: int) -> tuple[int, Entry]:
    caller.send_order("estop")
    began_ns = caller.line()["at_ns"]
    return began_ns, limp_frame(bench, began_ns)


def mute(bench: Bench, caller: Caller, trial: int) -> tuple[int, Entry]:
    caller.send_order("lower")
    ordered_ns = caller.line()["at_ns"]
    wait_for(lambda: bench.log.host("lowering", ordered_ns) or None, "the arm is lowered")
    time.sleep(MOMENTS_S[trial % len(MOMENTS_S)])
    began_ns = time.monotonic_ns()
    bench.twin.fault(f"off:{MUTE_SERVO}")
    return began_ns, limp_frame(bench, began_ns)


def main() -> None:
    """Run the trials, and print the worst figures as JSON."""
    robot, end, trials = sys.argv[1], sys.argv[2], int(sys.argv[3])
    ways = {"killed": killed, "estop": estop, **({"mute": mute} if end == "lower" else {})}
    figures: dict[str, float] = {}
    with Bench(robot + (LOWERING if end == "lower" else "")) as bench:
        for name, way in ways.items():
            worst = Figures()
            for trial in range(trials):
                caller = bench.moving("raise")
                began_ns, limp = way(bench, caller, trial)
                time.sleep(RESTS_S if way is killed else SETTLE_S)
                worst.add(bench, began_ns, limp)
                bench.twin.fault("ok")
                if way is killed:
                    bench.drop()
            unit, scale = ("s", 1.0) if name == "killed" else ("ms", 1e3)
            figures[f"{name}_limp_{unit}"] = round(worst.limp_s * scale, 3)
            if name == "killed":
                figures["killed_touch_m_s"] = round(worst.touch_m_s, 3)
            figures[f"{name}_setpoints_after"] = worst.after
    print(json.dumps(figures))


if __name__ == "__main__":
    main()

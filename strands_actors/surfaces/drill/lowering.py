"""The last step of a drill for an arm that is lowered: the script that holds it raised is killed.

The drill listens to the positions that the robot publishes, ten times a second. They show how fast the tool comes
down, and that the robot's processes end when the arm is limp. A simulated arm also logs all frames, and the speed
of every touch of its table.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import subprocess
from collections.abc import AsyncIterator, Awaitable, Callable
from time import monotonic_ns
from typing import Any

import trio

from strands_actors.caller.poses.tool_targets import ToolTargets
from strands_actors.caller.processes.plan import Plan
from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.channels.pubsub import Received
from strands_actors.kernel.clock import NS
from strands_actors.kernel.processes.interpreter import PYTHON, environment
from strands_actors.supervisors.mesh.schemas import key
from strands_actors.surfaces.mesh.client import open_mesh
from strands_actors.testing.caller import RAISED
from strands_actors.testing.twin import Twin

from .certificate import StepResult
from .report import LOWERED
from .steps import SETTLE_S, Failed

START_S = 30.0
BY_HAND_S = 120.0
HANDS_OFF_S = 3.0
SLOW_M_S = 0.3
"""A tool that comes down faster than this falls. The lowering keeps it at 0.25 m/s or below."""
MARGIN_S = 1.0
"""Time from the end of the lowering until the processes of the robot have ended."""

Ask = Callable[[str], Awaitable[None]]


class LoweringDrill:
    """The step ``script kill`` of a drill.

    Args:
        planned: The robot. Its port must be free.
        options: The user's options of the robot.
        twin: The simulated robot. None for a real robot.
        tell: Called with each instruction for the operator.
    """

    def __init__(self, planned: Plan, options: dict[str, Any], twin: Twin | None, tell: Ask) -> None:
        self._planned = planned
        self._options = options
        self._twin = twin
        self._tell = tell
        self._driver: Driver = planned.driver_class(planned.robot, planned.port, planned.options)
        self._tool = ToolTargets(self._driver)
        self._course: list[tuple[int, tuple[float, float, float]]] = []

    async def script_kill(self) -> StepResult:
        """Let a script hold the arm raised, kill the script, and judge how the arm comes down.

        Raises:
            Failed: The arm could not be raised.
        """
        async with self._raised() as script, open_mesh() as client:
            name = self._planned.tool_name
            await client.settle()
            if not client.is_there(name):
                raise Failed(f"the positions of {name} cannot be received")
            client.subscribe(key(name, "state"), self._hear)
            await trio.sleep(MARGIN_S)
            if not self._course:
                raise Failed(f"{name} publishes no position")
            began_ns = monotonic_ns()
            script.kill()
            with trio.move_on_after(self._driver.timing.safe_s + MARGIN_S) as waiting:
                while client.is_there(name):  # noqa: ASYNC110  # the robot is another process
                    await trio.sleep(0.02)
            ended_ns = monotonic_ns()
        if waiting.cancelled_caught:
            return self._result(False, None, f"not limp within {self._driver.timing.safe_s:.1f} s")
        await trio.sleep(SETTLE_S)
        return self._judge(began_ns, ended_ns)

    @contextlib.asynccontextmanager
    async def _raised(self) -> AsyncIterator[trio.Process]:
        """Start the script, and wait until it holds the arm raised."""
        settings = {
            "robot": self._planned.robot,
            "port": self._planned.port,
            "options": self._options,
            "pose": None if self._twin is None else RAISED[self._planned.robot],
        }
        script = await trio.lowlevel.open_process(
            [*PYTHON, "-m", "strands_actors.surfaces.drill.script"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment(),
        )
        assert script.stdin is not None
        try:
            await script.stdin.send_all(json.dumps(settings).encode() + b"\n")
            await self._until(script, "connected", START_S)
            if self._twin is None:
                await self._tell("Raise the arm by hand, with its tool 10 cm higher at least, and hold it still.")
            await self._until(script, "raised", BY_HAND_S)
            if self._twin is None:
                await self._tell("It holds itself. Hands off: it is laid down now.")
                await trio.sleep(HANDS_OFF_S)
            yield script
        finally:
            with contextlib.suppress(ProcessLookupError):
                script.kill()
            with trio.CancelScope(shield=True):
                await script.wait()

    async def _until(self, script: trio.Process, state: str, within_s: float) -> None:
        """Wait until the script has reached a state. Raise ``Failed`` if it ends, or needs too long."""
        assert script.stdout is not None and script.stderr is not None
        received = b""
        with trio.move_on_after(within_s):
            while data := await script.stdout.receive_some():
                received += data
                if f'"{state}"'.encode() in received:
                    return
            problem = (await script.stderr.receive_some()).decode(errors="replace").strip()
            raise Failed(problem or "the script has ended")
        raise Failed(f"the arm was not {state} within {within_s:g} s")

    def _hear(self, received: Received) -> None:
        state = json.loads(received.payload)
        tool = self._tool.place(state["joints"])
        if tool is not None:
            self._course.append((monotonic_ns(), tool))

    # -- the result

    def _judge(self, began_ns: int, ended_ns: int) -> StepResult:
        limp_s, fastest_m_s = (ended_ns - began_ns) / NS, self._fastest_m_s(began_ns)
        detail = f"limp after {limp_s:.1f} s, its tool at most {fastest_m_s:.2f} m/s fast"
        if self._twin is not None:
            touches = _touches_m_s(self._twin, began_ns)
            detail += f", {max(touches, default=0.0):.2f} m/s at the table"
        is_slow = fastest_m_s <= SLOW_M_S
        result = self._result(is_slow, limp_s * 1e3, detail if is_slow else f"it fell: {detail}")
        return result if self._twin is None else self._with_log(result, self._twin, began_ns)

    def _fastest_m_s(self, began_ns: int) -> float:
        course = [sample for sample in self._course if sample[0] >= began_ns]
        speeds = (
            math.dist(before, here) / ((here_ns - before_ns) / NS)
            for (before_ns, before), (here_ns, here) in itertools.pairwise(course)
        )
        return max(speeds, default=0.0)

    def _with_log(self, result: StepResult, twin: Twin, began_ns: int) -> StepResult:
        frames = twin.log.host("safe", began_ns)
        states = [frame.safe_state for frame in frames if frame.safe_state]
        if states[:1] != [SafeState.HOLD] or SafeState.LIMP not in states:
            return self._result(False, result.confirmed_ms, f"the frames on the wire are {', '.join(states)}")
        safe_ms = (frames[0].t_ns - began_ns) / 1e6
        after = twin.log.setpoints_after_safe(began_ns)
        passed = result.passed and safe_ms <= result.bound_ms and not after
        return self._result(passed, result.confirmed_ms, result.detail, round(safe_ms, 1), after)

    def _result(
        self,
        passed: bool,
        confirmed_ms: float | None,
        detail: str,
        safe_ms: float | None = None,
        after: int | None = None,
    ) -> StepResult:
        return StepResult(
            LOWERED,
            passed,
            self._driver.fallbacks[Reason.CALLER],
            safe_ms,
            confirmed_ms,
            self._driver.bound_s * 1e3,
            after,
            detail,
            ("SAF-002", "SAF-026"),
        )


def _touches_m_s(twin: Twin, since_ns: int) -> list[float]:
    """Return the speed of each touch of the table."""
    return [
        float(json.loads(entry.data)["speed_m_s"]) for entry in twin.log.entries(since_ns) if entry.kind == "touch"
    ]

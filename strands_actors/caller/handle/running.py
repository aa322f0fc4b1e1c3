"""``run``: let a policy control the robot for some seconds, and report what happened.

The policy may be given in any form (``policies.sources``). It runs as a rollout like that of ``run_policy`` or
``start_task``: an object in this process, all others in the process of the policy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from strands_actors.contract.driver import Driver
from strands_actors.contract.plain_numbers import as_python
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Refused
from strands_actors.policies.registry import choose_provider, robot_facts
from strands_actors.supervisors.gate.cause import Lapse
from strands_actors.supervisors.root.messages import TaskStatus

from ..session.tree import RobotTree
from . import envelopes as answers
from .envelopes import Answer
from .progress import Progress, Show, progress_of, show_of
from .verbs import DONE, check_length

if TYPE_CHECKING:
    from strands_actors.policies.sources import Source

RUN = "run"
LOAD_S = 300.0
"""Longest time until the first action. A large model loads in minutes."""
MAX_AGE_S = 10.0
"""Default of ``max_age``. A chunk of a hundred actions at 30 Hz is half as old when its last action is sent."""
DEFAULT_S = 10.0
"""Default duration of ``run``."""


class Run:
    """One call of ``run``: its checked arguments, and the state of its rollout.

    Args:
        driver: The driver of the robot.
        policy: The policy in any form, as in ``sources.choose``.
        seconds: Duration from the first action.
        instruction: Text for the policy.
        control_frequency: Actions per second; None for the rate that the policy states, else the driver's.
        progress: As in ``progress.show_of``.
        max_age: As in ``RealRobot.run``.
        options: Keyword arguments for the policy.

    Raises:
        TypeError: The policy is none, or ``progress`` is of another type.
        ValueError: An argument has a value that no rollout can have, or this robot runs no policies.
    """

    def __init__(
        self,
        driver: Driver,
        policy: object,
        seconds: float,
        instruction: str,
        control_frequency: float | None,
        progress: Show | bool | None,
        max_age: float,
        options: Mapping[str, Any],
    ) -> None:
        # Only a program that runs a policy needs this module.
        from strands_actors.policies.sources import choose

        self._seconds, hz = as_python(seconds), as_python(control_frequency)
        check_length(self._seconds, None, hz, "seconds")
        self._max_age_s = as_python(max_age)
        if (
            isinstance(self._max_age_s, bool)
            or not isinstance(self._max_age_s, int | float)
            or not self._max_age_s > 0
        ):
            raise ValueError(f"max_age is {max_age!r}. Give seconds, above 0")
        if not isinstance(instruction, str):
            raise TypeError(f"instruction is {instruction!r}. Give text")
        self.source: Source = choose(policy, options)
        if reason := driver.ROLLOUTS or (driver.TASKS if self.source.provider else ""):
            raise ValueError(f"{driver.robot}: {reason}")
        self.show = show_of(progress, self._seconds)
        self._hz = self.source.hz if hz is None else hz
        self._instruction = instruction
        self._refused_before = 0
        self._last = Progress(True, 0, 0.0, 0.0, None, 0)
        self._expired = False
        if self.source.provider:
            chosen = choose_provider(self.source.provider, "localhost", None, dict(self.source.options))
            self._provider, self._options = chosen

    async def begin(self, tree: RobotTree) -> Answer:
        """Start the rollout. Return a success, or the refusal of the start."""
        before = await tree.status()
        self._refused_before = 0 if before is None else before.refusals
        rollouts, arguments = tree.rollouts, (self._instruction, self._seconds)
        begun: TaskStatus | Refused
        if self.source.provider:
            options = {**robot_facts(self._provider, tree.driver, tree.robot, tree.cameras.names), **self._options}
            begun = await rollouts.start_task(
                self._provider.where, options, *arguments, self._hz, load_s=LOAD_S, max_age_s=self._max_age_s
            )
        else:
            begun = await rollouts.run_policy(
                self.source.policy, *arguments, 0, self._hz, RUN, LOAD_S, self._max_age_s
            )
        if isinstance(begun, Refused):
            return answers.refused(begun.about(RUN))
        return answers.success(answers.task(begun))

    async def look(self, tree: RobotTree) -> Progress:
        """Return how far the rollout is."""
        gate, task = await tree.status(), await tree.rollouts.task()
        self._last = progress_of(task, gate, self._refused_before)
        self._expired = gate is not None and gate.lapse == Lapse.EXPIRED
        return self._last

    async def end(self, tree: RobotTree) -> Answer:
        """End the rollout if it still runs, and return the answer of ``run``."""
        status, result = await tree.rollouts.stop_task()
        self._last = self._last._replace(running=False)
        done = {
            "robot": tree.robot,
            "policy": self.source.label,
            "source": str(self.source.kind),
            **answers.task(status),
            "refused": self._last.refused,
            "observation_age_s": self._last.observation_age_s,
            "action_age_s": round(status.action_age_s, 3),
        }
        held = answers.stop_result(RUN, result, done)
        if status.exit_reason in DONE or not status.exit_reason:
            return held
        json = held["content"][-1].get("json", done)
        unconfirmed = "" if held["status"] == "success" else f". {held['content'][0]['text']}"
        detail = f": {status.exit_detail}" if status.exit_detail else ""
        if self._expired:
            detail = busy.explained(detail)
        return answers.error(f"{RUN}: {self.source.label} ended: {status.exit_reason}{detail}{unconfirmed}", json)


__all__ = ["DEFAULT_S", "RUN", "Run"]

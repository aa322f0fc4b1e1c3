"""Run a policy in a simulation for some episodes, as fast as the physics is computed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from strands_actors.supervisors.policy import as_infer, prepare

STEP_S = 0.002
"""Time step of the physics, as of the service ``step``."""

Success = Callable[[Mapping[str, float]], object]


class Failed(Exception):
    """An episode cannot continue. The exception's text is the reason."""


class Simulated(Protocol):
    """The methods of a simulation that an evaluation calls."""

    def reset(self) -> Any: ...
    def get_observation(self) -> dict[str, float]: ...
    def step(self, steps: int = 1, action: Mapping[str, Any] | None = None) -> Any: ...


def evaluate_checked(
    sim: Simulated,
    policy: Any,
    provider: str,
    config: Mapping[str, Any] | None,
    axes: Sequence[str],
    hz: object,
    instruction: str,
    n_episodes: object,
    max_steps: object,
    success: Success | None,
    seed: object,
) -> dict[str, Any]:
    """Check the arguments of ``SimRobot.eval_policy``, and return the result of ``evaluate``.

    Raises:
        TypeError, ValueError: An argument is wrong.
        Failed: An episode cannot continue.
    """
    for name, count in (("n_episodes", n_episodes), ("max_steps", max_steps)):
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise ValueError(f"{name} is {count!r}. Give a whole number above 0")
    if isinstance(hz, bool) or not isinstance(hz, int | float) or not 0 < hz <= 1 / STEP_S:
        raise ValueError(f"control_frequency is {hz!r}. Give hertz, above 0 and at most {1 / STEP_S:g}")
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, int) or seed < 0):
        raise ValueError(f"seed is {seed!r}. Give a whole number, 0 or more")
    if success is not None and not callable(success):
        raise TypeError(
            f"success_fn is {success!r}. Give a function that takes an observation and returns True or False"
        )
    if policy is None:
        from strands_actors.policies import create_policy

        policy = create_policy(provider, **dict(config or {}))
    assert isinstance(n_episodes, int) and isinstance(max_steps, int)
    return evaluate(sim, policy, axes, float(hz), instruction, n_episodes, max_steps, success, seed)


def evaluate(
    sim: Simulated,
    policy: Any,
    axes: Sequence[str],
    hz: float,
    instruction: str,
    n_episodes: int,
    max_steps: int,
    success: Success | None,
    seed: int | None,
) -> dict[str, Any]:
    """Run a policy in a simulation for ``n_episodes`` episodes.

    Returns:
        A dict with ``n_episodes``, ``episodes`` (the result of each episode), and ``success_rate`` (the share
        of successful episodes, 0 to 1; None if ``success`` is None).

    Raises:
        Failed: An action was refused, or the policy gave no action.
        Exception: The policy's exceptions are passed on.
    """
    infer = as_infer(policy)
    steps = max(1, round(1 / (hz * STEP_S)))
    episodes = []
    for episode in range(n_episodes):
        _checked(sim.reset())
        prepare(policy, axes, hz)
        if seed is not None and callable(reset := getattr(policy, "reset", None)):
            reset(seed + episode)
        done = _episode(sim, infer, instruction, max_steps, steps, success)
        episodes.append({"episode": episode, "seed": None if seed is None else seed + episode, **done})
    won = sum(bool(each["success"]) for each in episodes)
    return {
        "n_episodes": n_episodes,
        "success_rate": None if success is None else won / n_episodes,
        "episodes": episodes,
    }


def _episode(
    sim: Simulated, infer: Any, instruction: str, max_steps: int, steps: int, success: Success | None
) -> dict[str, Any]:
    steps_done = 0
    observation = sim.get_observation()
    while steps_done < max_steps:
        chunk = infer(observation, instruction)[: max_steps - steps_done]
        if not chunk:
            raise Failed(f"the policy gave no action after {steps_done} steps")
        for action in chunk:
            observation = dict(_checked(sim.step(steps, action))["position"])
            steps_done += 1
            if success is not None and success(observation):
                return {"steps": steps_done, "success": True}
    return {"steps": steps_done, "success": None if success is None else False}


def _checked(answer: Any) -> dict[str, Any]:
    """Return the JSON content of a simulation's answer. Raise ``Failed`` if the answer is an error."""
    if answer["status"] == "error":
        raise Failed(answer["content"][0]["text"])
    result: dict[str, Any] = answer["content"][0]["json"]
    return result

"""The public verbs of a robot. Each is a function of a ``RobotTree`` and returns an envelope.

``Robot``, ``open_robot``, agents and MCP share these verbs. ``answered`` runs a verb. It returns an error
envelope if the robot's processes are missing or do not answer.

The functions ``..._here`` do the same in a thread of the program. They return None if they did nothing, and the
trio loop must then run the verb.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import Any

from strands_actors.contract.driver import Driver, Reason, Service
from strands_actors.contract.loading import load
from strands_actors.contract.plain_numbers import as_python
from strands_actors.contract.positions import Positions
from strands_actors.contract.shown import SHOWN
from strands_actors.contract.wire import Observation
from strands_actors.drivers import canonical_name
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.policies.registry import choose_provider, robot_facts
from strands_actors.supervisors import stop_result
from strands_actors.supervisors.gate.messages import Accepted, Performed, Resumed, Status
from strands_actors.supervisors.root.messages import TaskStatus

from ..processes.plan import Plan
from ..processes.robot_processes import NotConnected
from ..session.tree import RobotTree
from . import envelopes as answers
from . import refusals
from .envelopes import Answer
from .reference_names import hint

_log = logging.getLogger("strands_actors")

Verb = Callable[..., Coroutine[Any, Any, Answer]]
"""A verb: an async function of a ``RobotTree`` and further arguments. It runs in the trio loop."""
VerbHere = Callable[..., Answer | None]
"""A verb that runs in a thread of the program. None means that nothing was done, and that the loop must run it."""


async def answered(name: str, verb: Verb, tree: RobotTree, *args: Any) -> Answer:
    """Run a verb. Return an error envelope if the robot's processes are missing or do not answer."""
    try:
        return await verb(tree, *args)
    except AskTimeout as failure:
        return answers.error(busy.explained(f"{name}: {failure}"))
    except (NotConnected, Unreachable) as failure:
        return answers.error(f"{name}: {failure}")


def answered_here(name: str, blocking: VerbHere, tree: RobotTree, *args: Any) -> Answer | None:
    """Run a verb as ``answered`` does, but in the calling thread."""
    try:
        return blocking(tree, *args)
    except NotConnected as failure:
        return answers.error(f"{name}: {failure}")


def refuse_name(robot_name: object, plan: Plan, running_as: str, verb: str = "move") -> Answer | None:
    """Return a refusal if a command is meant for another robot.

    Args:
        robot_name: The name in the command; None means this robot. ``tool_name`` and ``running_as`` are
            accepted. Without a ``tool_name``, every name of this type of robot is accepted, too.
        plan: The plan of this robot (its checked arguments).
        running_as: The name by which this robot runs.
        verb: The verb that is refused.
    """
    if robot_name is None or robot_name in (plan.tool_name, running_as):
        return None
    is_text = isinstance(robot_name, str) and robot_name
    if is_text and plan.tool_name == plan.robot == canonical_name(str(robot_name)):
        return None
    return answers.refused(refusals.other_robot(verb, str(robot_name)[:SHOWN], running_as, plan.robot))


async def send_action(tree: RobotTree, action: Mapping[str, Any]) -> Answer:
    """Send one setpoint. The arguments and keys are those of ``RealRobot.send_action``."""
    return _commanded(tree, action, await tree.send_action(action))


def send_action_here(tree: RobotTree, action: Mapping[str, Any]) -> Answer | None:
    """Send one setpoint as ``send_action`` does, but in the calling thread."""
    answer = tree.send_action_here(action)
    return None if answer is None else _commanded(tree, action, answer)


def _commanded(tree: RobotTree, action: Mapping[str, Any], answer: Accepted | Refused) -> Answer:
    if isinstance(answer, Refused):
        return answers.refused(answer)
    return answers.success(tree.driver.accepted(action, answer.values, answer.sensors))


async def get_observation(tree: RobotTree) -> Answer:
    """Return the newest measured positions by joint, in the driver's units, as an envelope."""
    return _observed(tree, await tree.observe())


def get_observation_here(tree: RobotTree) -> Answer:
    """Return an observation as ``get_observation`` does, but in the calling thread."""
    return _observed(tree, tree.observe_here())


def _observed(tree: RobotTree, answer: Observation | Refused) -> Answer:
    if isinstance(answer, Refused):
        return answers.refused(answer)
    return answers.success(tree.driver.observed(answer))


class Observing:
    """Turn the envelopes of ``observe`` into the plain result of ``get_observation``, for one handle.

    It logs each reason for a missing reading once.
    """

    def __init__(self) -> None:
        self._last_reason = ""

    def positions(self, answer: Answer) -> dict[str, float]:
        """Return the positions by joint; {} for an error."""
        if answer["status"] == "error":
            reason: str = answer["content"][0]["text"]
            if reason != self._last_reason:
                _log.warning("%s", reason)
            self._last_reason = reason
            return {}
        self._last_reason = ""
        return Positions(answer["content"][0]["json"])


async def get_state(tree: RobotTree) -> Answer:
    """Return the positions and velocities of the joints, with the age of the reading."""
    return await _measured(tree, "state", lambda observation: _state(tree.driver, observation))


def _state(driver: Driver, observation: Observation) -> dict[str, Any]:
    """Return the values that the verb ``state`` reports, by key.

    ``joints`` and ``joint_velocities`` are the same values under their names in strands-robots.
    """
    velocities = answers.velocities(driver, observation)
    return {
        "robot": driver.robot,
        "joints": answers.positions(driver, observation),
        "joint_velocities": velocities,
        "velocities": velocities,
        **driver.readings(observation),
    }


async def get_sensors(tree: RobotTree) -> Answer:
    """Return the positions, the sensors and the faults of the motors, with the age of the reading."""
    return await _measured(
        tree,
        "sensors",
        lambda observation: {"sensors": answers.sensors(observation), "faults": dict(observation.faults)},
    )


async def _measured(tree: RobotTree, name: str, more: Callable[[Observation], dict[str, Any]]) -> Answer:
    status = await tree.status()
    if status is None:
        return answers.refused(busy.with_load(refusals.silent_process(name)))
    observation = status.observation
    if observation is None:
        return answers.refused(refusals.no_reading(name))
    return answers.success(
        {
            "positions": answers.positions(tree.driver, observation),
            "unit": tree.driver.unit,
            "age_s": round(status.age_s, 4),
            "state": status.mode,
            **more(observation),
        }
    )


async def release(tree: RobotTree) -> Answer:
    """Release the lease (the right to command the robot)."""
    result = await tree.release()
    if isinstance(result, Refused):
        return answers.refused(result)
    released = {} if isinstance(result, stop_result.Unreachable) else {"released": True}
    return answers.stop_result("release", result, released)


def is_service(plan: Plan | None, name: str) -> bool:
    """Return True if the driver has a service of this name."""
    return plan is not None and name in plan.driver_class.services(plan.options)


def require_service(handle: object, plan: Plan | None, name: str) -> None:
    """Raise ``AttributeError`` if the driver has no service of this name.

    Args:
        handle: The robot object on which the attribute was read.
        plan: The plan of that robot (its checked arguments); None while the object is being made.
        name: Name of the attribute.
    """
    if not is_service(plan, name):
        raise AttributeError(
            f"{type(handle).__name__} has no attribute {name!r}{_of_hardware(plan, name) or hint(name)}"
        )


def _of_hardware(plan: Plan | None, name: str) -> str:
    """Return a hint if only the real robot has this service, and its simulation lacks it.

    Return an empty text otherwise.
    """
    if plan is None or not plan.driver_class.SIMULATED:
        return ""
    if name not in load(plan.options["class"]).services(plan.options["options"]):
        return ""
    return (
        f". It is a service of the real {plan.robot}, and this is a simulation. Make it with mode='real' and "
        "port=, or with mode='real', transport='twin'"
    )


def name_values(
    plan: Plan, name: str, values: Sequence[Any], arguments: Mapping[str, Any]
) -> dict[str, Any] | Refused:
    """Return the arguments of a service by name, also those that were given by position.

    Only their number and names are checked here. The driver checks the values.
    """
    if not values:
        return dict(arguments)
    service = plan.driver_class.services(plan.options).get(name)
    names = () if service is None else tuple(service.arguments)
    takes = ", ".join(names) or "no arguments"
    if len(values) > len(names):
        return refusals.too_many_values(name, len(values), len(names), takes)
    placed = dict(zip(names, values, strict=False))
    if twice := sorted(placed.keys() & arguments.keys()):
        return refusals.given_twice(name, twice[0], takes)
    return {**placed, **arguments}


async def service(
    tree: RobotTree, name: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None = None
) -> Answer:
    """Run a service of the driver.

    A service may be declared as a command or as a stop. It is then sent as a command or a stop.
    """
    if (command := _command(tree, name, arguments, action)) is not None:
        return answers.refused(command) if isinstance(command, Refused) else await send_action(tree, command)
    if (reason := _stop_reason(tree, name)) is not None:
        return answers.stop_result(name, await tree.stop(reason, lock=True))
    return _performed(await tree.perform(name, arguments, action))


def service_here(
    tree: RobotTree, name: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None = None
) -> Answer | None:
    """Run a service as ``service`` does, but in the calling thread.

    None means that nothing was done, and that the loop must run the service.
    """
    if (command := _command(tree, name, arguments, action)) is not None:
        return answers.refused(command) if isinstance(command, Refused) else send_action_here(tree, command)
    if (reason := _stop_reason(tree, name)) is not None:
        return answers.stop_result(name, tree.stop_here(reason, lock=True))
    answer = tree.perform_here(name, arguments, action)
    return None if answer is None else _performed(answer)


def _command(
    tree: RobotTree, name: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None
) -> dict[str, Any] | Refused | None:
    """Return the action to send if the service is a command (``Service.acts``).

    Return a refusal if its arguments are wrong, and None if the service is not a command.
    """
    declared = tree.driver.SERVICES.get(name)
    if declared is None or not declared.acts:
        return None
    refusal = tree.driver.check_service(name, arguments)
    if refusal is not None:
        return refusal.about(name)
    return {**(action or {}), **action_of_service(declared, arguments)}


def action_of_service(service: Service, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the action that a service sends, for a service that is a command (``Service.acts``)."""
    values = {**service.arguments, **arguments}
    optional = {name for name, default in service.arguments.items() if default is None}
    return {name: value for name, value in values.items() if value is not None or name not in optional}


def _stop_reason(tree: RobotTree, name: str) -> Reason | None:
    """Return the reason of the stop for a service that is a stop (``Service.stops``); otherwise None.

    An unknown name also gives None. It is refused later.
    """
    declared = tree.driver.SERVICES.get(name)
    return None if declared is None else declared.stops


def _performed(answer: Performed | Refused) -> Answer:
    return answers.refused(answer) if isinstance(answer, Refused) else answers.success(answer.result)


async def stop(tree: RobotTree) -> Answer:
    """Bring the robot to its safe state. The keys are those of ``RealRobot.stop``."""
    return answers.stop_result("stop", await tree.stop())


def stop_here(tree: RobotTree) -> Answer:
    """Stop the robot as ``stop`` does, but in the calling thread."""
    return answers.stop_result("stop", tree.stop_here())


async def get_status(tree: RobotTree) -> Answer:
    """Return the status of the robot and its processes, also if the robot does not answer."""
    return answers.success(describe(tree, await tree.status()))


def describe(tree: RobotTree, status: Status | None) -> dict[str, Any]:
    """Return the values that ``get_status`` reports, by key.

    Args:
        tree: The robot.
        status: The status from the gate; None if the gate did not answer.
    """
    problem = tree.problem or busy.explained("the process that talks to the robot does not answer")
    described = answers.status(
        tree.plan.tool_name, tree.plan.robot, tree.driver, problem, status, tree.facts, tree.standby_report
    )
    if tree.cameras:
        described["cameras"] = tree.cameras.status()
    if tree.caveats:
        described["caveats"] = list(tree.caveats)
    # A busy computer causes the same timeouts as a loose cable, so the status shows the computer's load.
    load = busy.machine()
    if load.pressure is not None:
        described["machine_busy_pct"] = round(100 * load.pressure)
    described["machine"] = load.text
    return described


async def resume(tree: RobotTree, lift: bool = True) -> Answer:
    """Energise the robot at its measured position. It starts no motion.

    Args:
        tree: The robot.
        lift: True lifts the lock of an e-stop. False only energises, for a caller that is not an operator.

    Returns:
        The keys of ``RealRobot.resume``.
    """
    answer = await tree.resume(lift)
    if isinstance(answer, Refused):
        return answers.refused(answer)
    assert isinstance(answer, Resumed)
    position = tree.driver.observed(answer.observation)
    return answers.success({"armed": True, "epoch": answer.epoch, "position": position})


async def get_task_status(tree: RobotTree) -> Answer:
    """Return the status of the policy or motion that runs, or of the last one that ran."""
    return answers.success(answers.task(await tree.rollouts.task()))


DONE = ("duration", "n_steps", "stopped")
"""Exit reasons of a policy or motion that are no error."""


async def stop_task(tree: RobotTree) -> Answer:
    """End the policy or motion. Return its status and the result of the hold."""
    status, result = await tree.rollouts.stop_task()
    done = {"robot": tree.robot, **answers.task(status)}
    return answers.stop_result("stop_task", result, done)


def _begun(status: TaskStatus | Refused) -> Answer:
    if isinstance(status, Refused):
        return answers.refused(status)
    return answers.success(answers.task(status))


# -- start a policy (wrong arguments are refused before the robot's processes are needed)


def run_policy(
    policy: Any,
    policy_object: Any,
    instruction: str,
    duration: float,
    n_steps: int | None,
    hz: float | None,
    wait: bool,
) -> Verb | Answer:
    """Check the arguments, and return a verb that runs the policy, or an error envelope.

    The arguments are those of ``RealRobot.run_policy``.
    """
    duration, n_steps, hz = map(as_python, (duration, n_steps, hz))
    try:
        check_length(duration, n_steps, hz)
        chosen = _choose_policy(policy, policy_object)
    except (TypeError, ValueError) as failure:
        return answers.error(f"run_policy: {failure}")

    async def run(tree: RobotTree) -> Answer:
        rollouts = tree.rollouts
        begun = await rollouts.run_policy(chosen, instruction, duration, n_steps or 0, hz)
        if isinstance(begun, Refused) or not wait:
            return _begun(begun)
        ended = await rollouts.wait()
        if rollouts.failure is not None:
            raise rollouts.failure
        if ended.exit_reason in DONE:
            return answers.success(answers.task(ended))
        return answers.error(f"run_policy: {ended.exit_reason}: {ended.exit_detail}", answers.task(ended))

    return run


def start_task(
    driver: Driver,
    provider: str,
    host: str,
    port: int | None,
    options: dict[str, Any],
    instruction: str,
    duration: float,
    hz: float | None,
) -> Verb | Answer:
    """Check the arguments, and return a verb that starts the policy, or an error envelope.

    The arguments are those of ``RealRobot.start_task``.
    """
    duration, hz = map(as_python, (duration, hz))
    try:
        if reason := driver.ROLLOUTS or driver.TASKS:
            raise ValueError(f"{driver.robot}: {reason}")
        check_length(duration, None, hz)
        policy, chosen = choose_provider(provider, host, port, options)
    except ValueError as failure:
        return answers.error(f"start_task: {failure}")

    async def run(tree: RobotTree) -> Answer:
        policy_options = {**robot_facts(policy, tree.driver, tree.robot, tree.cameras.names), **chosen}
        return _begun(await tree.rollouts.start_task(policy.where, policy_options, instruction, duration, hz))

    return run


def check_length(duration: object, n_steps: object, hz: object, keyword: str = "duration") -> None:
    """Raise ``ValueError`` for a duration, a number of steps or a rate that no policy can have.

    ``keyword`` is the name of the duration in the user's call.
    """
    if isinstance(duration, bool) or not isinstance(duration, int | float) or not 0 < duration < math.inf:
        raise ValueError(f"{keyword} is {duration!r}. Give a finite number of seconds above 0")
    if n_steps is not None and (isinstance(n_steps, bool) or not isinstance(n_steps, int) or n_steps < 1):
        raise ValueError(f"n_steps is {n_steps!r}. Give a whole number above 0")
    if hz is not None and (isinstance(hz, bool) or not isinstance(hz, int | float) or not 0 < hz <= 1000):
        raise ValueError(f"control_frequency is {hz!r}. Give a rate in hertz, above 0 and at most 1000")


def _choose_policy(policy: Any, policy_object: Any) -> Any:
    """Return the policy from one of its two keywords. Raise ``TypeError`` if both or neither is given."""
    if policy is not None and policy_object is not None:
        raise TypeError("policy and policy_object are both given. Give one of them")
    chosen = policy if policy is not None else policy_object
    if chosen is None:
        raise TypeError("policy is None. Give an object with get_actions_sync, get_actions or step, or a callable")
    # This module imports asyncio, which takes 10 ms. So only a program that runs a policy imports it.
    from strands_actors.supervisors.policy import as_infer

    as_infer(chosen)
    return chosen

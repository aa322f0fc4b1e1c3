"""The texts of the refusals of a robot's handle: one function for each text."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code


def with_remedy(fields: Mapping[str, str], remedy: str) -> Refused:
    """Return the refusal with these fields (those in an error envelope) and with another remedy."""
    return Refused(**{**fields, "remedy": remedy})


# -- the arguments of a verb


def other_robot(verb: str, robot_name: str, running_as: str, robot: str) -> Refused:
    reason = f"robot_name is {robot_name!r}, and this robot is {running_as} ({robot})"
    remedy = "send it to the robot that it is meant for, or leave robot_name out"
    return Refused(Code.OTHER_ROBOT, reason, remedy, robot_name, running_as, verb=verb)


def unknown_command(command: str, robot: str, commands: str) -> Refused:
    reason = f"{robot} has no such command"
    return Refused(Code.UNKNOWN_COMMAND, reason, f"it has {commands}", command, commands, verb=command)


def too_many_values(verb: str, given: int, most: int, inputs: str) -> Refused:
    reason = f"{given} values were given"
    return Refused(Code.BAD_INPUT, reason, f"it takes {inputs}", str(given), str(most), verb=verb)


def given_twice(verb: str, name: str, inputs: str) -> Refused:
    return Refused(Code.BAD_INPUT, f"{name} is given twice", f"it takes {inputs}", name, inputs, verb=verb)


# -- readings


def silent_process(verb: str) -> Refused:
    reason = "the process that talks to the robot does not answer"
    return Refused(Code.NO_OBSERVATION, reason, "try again in a moment", verb=verb)


def no_reading(verb: str) -> Refused:
    reason = "no reading of the robot has come yet"
    return Refused(Code.NO_OBSERVATION, reason, "try again in a moment", verb=verb)

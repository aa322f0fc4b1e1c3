"""Turn ``Robot(name, attach=True)`` into a plan. The robot's host has all other settings."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from strands_actors.contract.cameras import CameraSettings
from strands_actors.contract.loading import load
from strands_actors.contract.shown import shown

from ..processes.attached_processes import hosted_settings
from ..processes.plan import Plan
from ..processes.robot_processes import NotConnected

OWN = frozenset({"arm", "approve", "guarded", "approve_within_s"})
"""Keywords of ``Robot`` that a handle of a host's robot takes, besides ``attach``."""


class AttachedPlan(NamedTuple):
    """A robot that a host keeps, with the keywords of the host's file for its handles.

    Attributes:
        plan: The robot.
        arm: False if a connect energises nothing, by the file.
        guarded: Verbs and keys that need approval, in addition to the driver's.
        approve: ``module:function`` that gives the approval; empty if it is not in the file.
        approve_within_s: Longest time of an approval; None if it is not in the file.
    """

    plan: Plan
    arm: bool
    guarded: tuple[str, ...]
    approve: str
    approve_within_s: float | None


def check_keywords(name: object, given: dict[str, Any]) -> None:
    """Raise ``TypeError`` if a keyword was given that only the robot's host can use."""
    if not isinstance(name, str):
        raise TypeError(f"Robot: the name is {shown(name)}. Give the name of a robot of a host, as text")
    if ignored := [keyword for keyword in given if keyword not in OWN]:
        raise TypeError(
            f"Robot: only the host of {name} can set {', '.join(f'{key}=' for key in ignored)}. Leave that out, "
            "or set it in the host's file"
        )


async def attached_plan(name: str) -> AttachedPlan:
    """Ask the robot's root process for the plan. Raise ``ConnectionError`` if no host keeps such a robot."""
    try:
        settings = await hosted_settings(name)
    except NotConnected as failure:
        raise ConnectionError(f"Robot: {failure}") from None
    driver = settings["driver"]
    plan = Plan(
        driver["robot"],
        name,
        load(driver["class"]),
        driver["port"],
        settings["transport"],
        driver["options"],
        data_config=settings["data_config"],
        lifetime_s=settings["lifetime_s"],
        cameras=tuple(msgspec.convert(camera, CameraSettings) for camera in settings["cameras"]),
        attached=True,
    )
    return AttachedPlan(
        plan, settings["arm"], tuple(settings["guarded"]), settings["approve"], settings["approve_within_s"]
    )

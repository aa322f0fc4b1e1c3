"""Turn the arguments of a robot that is made of parts into a plan for each part, and one for the whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import msgspec

from strands_actors.contract.cameras import CameraSettings
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import place_of
from strands_actors.contract.shown import closest, shown
from strands_actors.drivers import canonical_name, get_native_driver_class
from strands_actors.parts.tables import CAMERA_JOINED_BY, JOINED_BY, TABLES
from strands_actors.surfaces.cameras.config import ROBOT, source_of

from ..processes.plan import Plan
from .wanted import RobotArguments, is_tool_name

PLACED = "robot"
"""The keyword of a part with the name of its robot. Its other keywords are those of ``Robot``."""
WHOLE = ("id", "tool_name", "peer_id", "arm", "approve", "guarded", "approve_within_s", "mesh", "at", "attach")
"""Keywords of ``Robot`` that only the whole robot takes."""


def parts_plan(arguments: RobotArguments, driver_class: type[Driver], plan_of: Callable[..., Plan]) -> Plan:
    """Return the plan of a robot of parts.

    Args:
        arguments: The checked arguments of ``Robot``.
        driver_class: The driver of robots of parts.
        plan_of: Makes the plan of one part from its keywords of ``Robot``.

    Raises:
        ValueError: A part is missing, or its name, its robot or one of its keywords is wrong.
        TypeError: A value has the wrong type, or only a part can use the keyword.
    """
    name = arguments.name
    _refuse_keywords(arguments)
    table = TABLES.get(arguments.robot, {})
    settings = _settings(name, table.get("parts", {}), arguments.options.get("parts"))
    transport = {} if arguments.transport is None else {"transport": arguments.transport}
    parts: dict[str, Plan] = {}
    for part, own in settings.items():
        keywords = {**transport, **own}
        robot = keywords.pop(PLACED)
        keywords.setdefault("mode", arguments.mode)
        try:
            made = plan_of(robot, id=f"{arguments.tool_name}_{part}", **keywords, **_ends(arguments, robot, own))
        except (ValueError, TypeError) as failure:
            raise type(failure)(f"{failure} (part {part} of {name})") from None
        if not issubclass(made.driver_class, Driver) or not made.driver_class(made.robot, "", made.options).table:
            raise ValueError(
                f"Robot: part {part} of {name}: {robot} cannot be a part. Give a robot with a driver here"
            )
        parts[part] = made
    joined_by = str(table.get("joined_by", JOINED_BY))
    return Plan(
        arguments.robot,
        arguments.tool_name,
        driver_class,
        "",
        arguments.transport,
        options_of(parts, joined_by),
        data_config=arguments.data_config,
        mesh=arguments.mesh,
        lifetime_s=arguments.lifetime_s,
        cameras=_cameras(parts),
        policy_limits=arguments.policy_limits,
        parts={part: replace(made, cameras=()) for part, made in parts.items()},
    )


def options_of(parts: Mapping[str, Plan], joined_by: str) -> dict[str, Any]:
    """Return the options of the driver of the whole robot."""
    rows = [
        {"name": name, "class": place_of(part.driver_class), "robot": part.robot, "options": part.options}
        for name, part in parts.items()
    ]
    return {"parts": rows, "joined_by": joined_by}


def _cameras(parts: Mapping[str, Plan]) -> tuple[CameraSettings, ...]:
    """Return the cameras of all parts, as ``left_wrist``. The processes of the whole robot read them, so that one
    dataset has them all."""
    return tuple(
        msgspec.structs.replace(
            camera,
            name=f"{name}{CAMERA_JOINED_BY}{camera.name}",
            type=source_of(camera, part.driver_class) if camera.type == ROBOT else camera.type,
        )
        for name, part in parts.items()
        for camera in part.cameras
    )


def _refuse_keywords(arguments: RobotArguments) -> None:
    """Raise ``TypeError`` if a keyword is given that only a part, or no robot of parts, can use."""
    given = {"port": arguments.port, "sim": arguments.sim, "cameras": arguments.cameras}
    given |= {"at": arguments.host_address, "require_drill": arguments.drill_age_s}
    given |= dict.fromkeys(arguments.scene.simulation_keywords(), True)
    if ignored := [f"{key}=" for key, value in given.items() if value is not None]:
        raise TypeError(
            f"Robot: {arguments.name} is made of parts, and takes no {', '.join(ignored)} itself. Give it to a "
            "part: parts={'left': {'port': ...}}"
        )


def _settings(name: str, table: Mapping[str, Any], given: object) -> dict[str, dict[str, Any]]:
    """Return the keywords of each part: those of the robot's table, and the given ones in their place."""
    if given is None:
        given = {}
    if not isinstance(given, Mapping) or not all(isinstance(own, Mapping) for own in given.values()):
        raise TypeError(
            f"Robot: parts is {shown(given)}. Give keywords by part: {{'left': {{'robot': 'so101', 'port': ...}}}}"
        )
    settings = {part: dict(own) for part, own in table.items()}
    for part, own in given.items():
        if table and part not in table:
            hint = f" Did you mean {close[0]!r}?" if (close := closest(str(part), list(table))) else ""
            raise ValueError(f"Robot: {name} has no part {part!r}.{hint} Its parts are {', '.join(table)}")
        if not isinstance(part, str) or not is_tool_name(part) or not part.isalnum():
            raise ValueError(f"Robot: a part of {name} is called {part!r}. Use letters and digits")
        settings[part] = settings.get(part, {}) | dict(own)
    if len(settings) < 2:
        raise ValueError(f"Robot: {name} has {len(settings)} parts. Give at least two")
    for part, own in settings.items():
        if PLACED not in own:
            raise ValueError(f"Robot: part {part} of {name} has no robot. Add 'robot': the name of a robot")
        if wrong := [f"{key}=" for key in own if key in WHOLE]:
            raise TypeError(f"Robot: {', '.join(wrong)} is for the whole robot. Leave it out of part {part}")
    return settings


def _ends(arguments: RobotArguments, robot: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """Return the option ``on_exit`` of the whole robot for a part that is an arm which can be lowered."""
    on_exit, driver_class = arguments.options.get("on_exit"), get_native_driver_class(robot)
    if on_exit is None or "on_exit" in own or driver_class is None or not issubclass(driver_class, Driver):
        return {}
    return {"on_exit": on_exit} if driver_class.is_lowered(canonical_name(robot)) else {}

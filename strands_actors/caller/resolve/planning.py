"""Turn the checked arguments of ``Robot(...)`` into a plan of the processes to start."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from strands_actors.contract.cameras import CameraSettings
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load, place_of
from strands_actors.drivers import MODEL, PLAIN, SIMULATION, driver_name
from strands_actors.kernel.processes.limits import PolicyLimits
from strands_actors.surfaces.cameras.config import SCENE, read_cameras

from ..processes.plan import Plan
from ..processes.twin_process import SIM, TwinProcess
from .simulated import check_keyframe, read_own_model
from .wanted import Wanted, adapters, is_serial, read

TWIN = "twin"
"""The transport that starts the robot's twin. Other transports belong to a driver."""


def plan(name: str, mode: str = "sim", **keywords: Any) -> Plan:
    """Return the plan for the arguments of ``Robot(...)``.

    Raises:
        ValueError: A name, a value or a keyword is wrong. The text has the accepted ones.
        TypeError: A value has the wrong type, or the chosen mode would ignore the keyword.
    """
    wanted, driver_class = read(name, mode, **keywords)
    if wanted.mode == "sim" and (issubclass(driver_class, Driver) or wanted.scene.model(wanted.robot) is not None):
        return _simulated(wanted, driver_class)
    if driver_class is load(MODEL):
        raise ValueError(
            f"Robot: {wanted.name} is a model without a driver for hardware. leave out port= and mode="
        )
    if not issubclass(driver_class, Driver):
        return _plain(wanted, driver_class)
    _check_scene(wanted)
    driver_class = driver_class.at_level(wanted.robot, wanted.options)
    return _elsewhere(wanted, driver_class) if wanted.at else _real(wanted, driver_class)


def _check_scene(wanted: Wanted) -> None:
    """Raise ``TypeError`` if a keyword of simulations is given for another mode."""
    if ignored := wanted.scene.given():
        raise TypeError(
            f"Robot: {', '.join(f'{key}=' for key in ignored)} are of a simulation, and mode is {wanted.mode!r}. "
            "leave that out"
        )


async def completed(wanted: Plan) -> Plan:
    """Return the plan with the options that only the robot knows. Raise ``WireDown``.

    A twin is new, and the host of a distant robot asks that robot itself. In both cases the plan is
    returned unchanged.
    """
    if wanted.twin_process is not None or wanted.at:
        return wanted
    options = await wanted.driver_class.complete(wanted.robot, wanted.port, wanted.options)
    return wanted if options == wanted.options else replace(wanted, options=options)


# -- in simulation


def _simulated(wanted: Wanted, driver_class: type[Driver]) -> Plan:
    scene = wanted.scene
    file = scene.model(wanted.robot)
    if file is not None:
        driver_class, resolved, twin = read_own_model(wanted.robot, file, scene)
        return _simulation(wanted, driver_class, resolved, twin)
    check_keyframe(wanted.robot, scene)
    if why := driver_class.SIMULATION:
        raise ValueError(f"Robot: there is no simulation of {wanted.name}: {why}")
    return _simulation(wanted, driver_class, driver_class.resolve(wanted.robot, {}), None)


def _simulation(
    wanted: Wanted, driver_class: type[Driver], resolved: dict[str, Any], twin: dict[str, Any] | None
) -> Plan:
    if ignored := wanted.given():
        raise TypeError(
            f"Robot: a simulation of {wanted.name} would ignore {', '.join(f'{key}=' for key in ignored)}. "
            "add mode='real', or leave it out"
        )
    options = {"class": place_of(driver_class), "options": resolved, "gated": wanted.scene.gated}
    simulation = load(SIMULATION)
    cameras = _cameras(wanted, simulation, options)
    twin_process = TwinProcess(
        driver_class.TWIN,
        wanted.robot,
        has_control=True,
        place=wanted.scene.place,
        options=twin,
        pictures=_draws(cameras),
        backend=wanted.scene.other_backend,
    )
    return Plan(
        wanted.robot,
        wanted.tool_name,
        simulation,
        "",
        SIM,
        options,
        twin_process,
        data_config=wanted.data_config,
        mesh=wanted.mesh,
        cameras=cameras,
    )


def _cameras(wanted: Wanted, driver_class: type[Driver], resolved: dict[str, Any]) -> tuple[CameraSettings, ...]:
    """Raise ``TypeError`` or ``ValueError``."""
    if wanted.cameras is None:
        return ()
    axes = driver_class(wanted.robot, wanted.port or "", resolved).axes
    simulated = wanted.mode == "sim" or (wanted.transport == TWIN and not driver_class.SIMULATION)
    return read_cameras(wanted.cameras, driver_class=driver_class, axes=axes, simulated=simulated)


def _draws(cameras: Iterable[CameraSettings]) -> bool:
    """Return True if one of the cameras shows the scene."""
    return any(camera.type == SCENE for camera in cameras)


# -- on hardware, or on a twin


def _real(wanted: Wanted, driver_class: type[Driver]) -> Plan:
    _check_hardware(wanted, driver_class)
    tool_name = wanted.tool_name
    twin_process = None
    owns_twin_process = True
    if wanted.transport == TWIN:
        owns_twin_process = wanted.sim is None
        # Without ``tool_name`` no calibration is read, since a new twin has no calibration.
        resolved = _resolve(wanted, driver_class, wanted.options)
        cameras = _cameras(wanted, driver_class, resolved)
        draws = _draws(cameras)
        twin_process = (
            TwinProcess(driver_class.TWIN, wanted.robot, has_control=draws, pictures=draws, on_wire=draws)
            if owns_twin_process
            else _twin_process_of(wanted)
        )
    else:
        way = {} if wanted.transport is None else {"transport": wanted.transport}
        resolved = _resolve(wanted, driver_class, {**wanted.options, **way, "tool_name": tool_name})
        _check_port(wanted, driver_class, resolved)
        cameras = _cameras(wanted, driver_class, resolved)
    return Plan(
        wanted.robot,
        tool_name,
        driver_class,
        wanted.port or "",
        wanted.transport,
        resolved,
        twin_process,
        owns_twin_process,
        wanted.data_config,
        wanted.mesh,
        wanted.drill_age_s,
        lifetime_s=wanted.lifetime_s,
        cameras=cameras,
        policy_limits=wanted.policy_limits,
    )


def _elsewhere(wanted: Wanted, driver_class: type[Driver]) -> Plan:
    """Return the plan for a robot of another host, which has the arguments for the hardware."""
    assert wanted.at is not None
    _leave_to_host(wanted)
    return Plan(
        wanted.robot,
        wanted.tool_name,
        driver_class,
        "",
        None,
        _resolve(wanted, driver_class, wanted.options),
        data_config=wanted.data_config,
        mesh=wanted.mesh,
        at=wanted.at,
        lifetime_s=wanted.lifetime_s,
        policy_limits=wanted.policy_limits,
    )


def _plain(wanted: Wanted, driver_class: type[Any]) -> Plan:
    """Return the plan for a plain driver class (of strands-robots' drivers page or of LeRobot), which has
    no tree."""
    name = driver_class.__name__
    if wanted.mode == "sim":
        raise ValueError(f"Robot: {name} has no simulation of {wanted.name}. use mode='real'")
    if wanted.sim is not None or wanted.transport == "twin":
        raise ValueError(f"Robot: {name} has no twin of ours. give its port")
    if wanted.at is None:
        _check_hardware(wanted, driver_class)
    else:
        _leave_to_host(wanted)
    own = {"port": wanted.port, "transport": wanted.transport, "cameras": wanted.cameras}
    own |= {"tool_name": wanted.tool_name, "data_config": wanted.data_config}
    given = {key: value for key, value in own.items() if value is not None} | wanted.options
    plain = load(getattr(driver_class, "DRIVER", PLAIN))
    options = plain.options_of(driver_class, wanted.robot, given)
    if wanted.at is not None and not plain(wanted.robot, "", options).axes:
        raise ValueError(
            f"Robot: {name} does not say which axes it has before it is made. Give the class action_features, a "
            f"mapping of keys, to reach it at {wanted.at}"
        )
    return Plan(
        wanted.robot,
        wanted.tool_name,
        plain,
        wanted.port or "",
        None,
        options,
        data_config=wanted.data_config,
        mesh=wanted.mesh,
        drill_age_s=wanted.drill_age_s,
        at=wanted.at or "",
        lifetime_s=wanted.lifetime_s,
        policy_limits=wanted.policy_limits,
    )


def _leave_to_host(wanted: Wanted) -> None:
    """Raise ``TypeError`` for a keyword that belongs to the host of the robot."""
    own = ("port", "transport", "sim", "cameras", "require_drill")
    given = wanted.given() | ({} if wanted.cameras is None else {"cameras": wanted.cameras})
    ignored = [key for key in given if key in own]
    if wanted.policy_limits != PolicyLimits():
        ignored.append("policy_limits")
    if ignored:
        raise TypeError(
            f"Robot: a robot at {wanted.at} has its own {', '.join(f'{key}=' for key in ignored)}. leave that out"
        )


def _check_hardware(wanted: Wanted, driver_class: type[Any]) -> None:
    name, transport = driver_name(driver_class), wanted.transport
    offered = tuple(getattr(driver_class, "TRANSPORTS", ()))
    if transport is not None and transport not in offered:
        words = (*offered, "serial") if is_serial(driver_class) else offered
        raise ValueError(f"Robot: {name} has no transport {transport!r}. it offers {', '.join(words) or 'none'}")
    if wanted.sim is not None and transport != TWIN:
        raise ValueError(
            "Robot: sim= is what a twin is made of: add transport='twin'. "
            f"{name} offers {', '.join(offered) or 'none'}"
        )
    is_plain = not issubclass(driver_class, Driver)
    if wanted.cameras and is_plain and not getattr(driver_class, "reads_cameras", False):
        raise ValueError(f"Robot: {name} opens no cameras. leave out cameras=, and read them beside the robot")
    if transport == TWIN and wanted.port is not None:
        raise ValueError(f"Robot: port={wanted.port!r} and transport={transport!r} are both given. choose one")
    needs_port = hasattr(driver_class, "PORT_KIND") and not getattr(driver_class, "PORT_OPTIONAL", False)
    if transport is None and wanted.port is None and needs_port:
        raise ValueError(_missing_port(wanted.robot, driver_class))


def _resolve(wanted: Wanted, driver_class: type[Driver], options: dict[str, Any]) -> dict[str, Any]:
    """Return the options as the driver reads them. If a keyword has two names, a refusal has the one that
    the user gave, too."""
    try:
        return driver_class.resolve(wanted.robot, options)
    except (TypeError, ValueError) as refusal:
        if not wanted.spelled:
            raise
        names = ", ".join(f"{given} is another name of {own}" for own, given in wanted.spelled.items())
        error_class = ValueError if isinstance(refusal, ValueError) else TypeError
        raise error_class(f"{refusal} ({names})") from None


def _check_port(wanted: Wanted, driver_class: type[Driver], resolved: dict[str, Any]) -> None:
    driver = driver_class(wanted.robot, wanted.port or "", resolved)
    try:
        driver.check_port()
    except ValueError as refusal:
        raise ValueError(f"Robot: {wanted.robot}: {refusal}") from None


def _twin_process_of(wanted: Wanted) -> TwinProcess:
    twin_process = getattr(wanted.sim, "twin_process", None)
    if getattr(wanted.sim, "transport", None) != SIM or not isinstance(twin_process, TwinProcess):
        raise ValueError(f"Robot: sim is {wanted.sim!r}. give a simulation: Robot({wanted.robot!r}), mode 'sim'")
    if twin_process.robot != wanted.robot:
        raise ValueError(f"Robot: sim is a {twin_process.robot}. give a simulation of {wanted.robot}")
    return twin_process


def _missing_port(robot: str, driver_class: type[Any]) -> str:
    if driver_class.PORT_KIND != "serial":
        like = getattr(driver_class, "PORT_LIKE", "192.0.2.10")
        return f"Robot: {robot} needs 'port', its address: Robot({robot!r}, mode='real', port={like!r})"
    from serial.tools import list_ports

    devices = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
    doubt = "" if adapters(driver_class) else ", none looks like a servo bus"
    return (
        f"Robot: {robot} needs 'port': Robot({robot!r}, mode='real', port='/dev/ttyACM0'). "
        f"serial devices here: {devices}{doubt} (a path is not an identity: check which robot is behind it)"
    )

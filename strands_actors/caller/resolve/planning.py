"""Turn the checked arguments of ``Robot(...)`` into a plan of the processes to start."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from strands_actors.contract.cameras import CameraSettings
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load, place_of
from strands_actors.drivers import MODEL, PARTS, PLAIN, SIMULATION, driver_name
from strands_actors.kernel.processes.limits import PolicyLimits
from strands_actors.surfaces.cameras.config import SCENE, read_cameras

from ..processes.plan import Plan
from ..processes.twin_process import SIM, TwinProcess
from .simulated import check_built_in, read_own_model
from .wanted import RobotArguments, adapters, is_serial, read

TWIN = "twin"
"""The transport that starts a simulated robot (a twin). Other transports belong to a driver."""


def plan(name: str, mode: str = "sim", **keywords: Any) -> Plan:
    """Return the plan for the arguments of ``Robot(...)``.

    Raises:
        ValueError: A name, a value or a keyword is wrong. The text lists the accepted ones.
        TypeError: A value has the wrong type, or the chosen mode would ignore the keyword.
    """
    arguments, driver_class = read(name, mode, **keywords)
    if driver_class is load(PARTS):
        # Only a robot of parts needs this import.
        from .parts import parts_plan

        return parts_plan(arguments, driver_class, plan)
    if arguments.mode == "sim" and (
        issubclass(driver_class, Driver) or arguments.scene.model(arguments.robot) is not None
    ):
        return _simulated(arguments, driver_class)
    if driver_class is load(MODEL):
        raise ValueError(
            f"Robot: {arguments.name} is a model without a driver for hardware. Leave out port= and mode="
        )
    if not issubclass(driver_class, Driver):
        return _plain(arguments, driver_class)
    _check_scene(arguments)
    driver_class = driver_class.for_level(arguments.robot, arguments.options)
    return _elsewhere(arguments, driver_class) if arguments.host_address else _real(arguments, driver_class)


def _check_scene(arguments: RobotArguments) -> None:
    """Raise ``TypeError`` if a keyword of simulations is given for another mode."""
    if ignored := arguments.scene.simulation_keywords():
        raise TypeError(
            f"Robot: only a simulation takes {', '.join(f'{key}=' for key in ignored)}, "
            f"and mode is {arguments.mode!r}. Leave that out"
        )


async def completed(robot_plan: Plan) -> Plan:
    """Add the options that only the robot knows to a plan. Raise ``WireDown`` if the robot cannot be asked.

    Some plans are returned unchanged. The plan of a simulated robot, since a new robot knows no options. And the
    plan of a robot that another program has started, since that program asks the robot itself.
    """
    if robot_plan.twin_process is not None or robot_plan.host_address or robot_plan.attached:
        return robot_plan
    if robot_plan.parts:
        from .parts import options_of

        parts = {name: await completed(part) for name, part in robot_plan.parts.items()}
        return replace(robot_plan, parts=parts, options=options_of(parts, robot_plan.options["joined_by"]))
    options = await robot_plan.driver_class.complete(robot_plan.robot, robot_plan.port, robot_plan.options)
    return robot_plan if options == robot_plan.options else replace(robot_plan, options=options)


# -- plans for a simulation


def _simulated(arguments: RobotArguments, driver_class: type[Driver]) -> Plan:
    scene = arguments.scene
    file = scene.model(arguments.robot)
    if file is not None:
        driver_class, resolved, twin = read_own_model(arguments.robot, file, scene)
        return _simulation(arguments, driver_class, resolved, twin)
    check_built_in(arguments.robot, scene)
    if reason := driver_class.SIMULATION:
        raise ValueError(f"Robot: there is no simulation of {arguments.name}: {reason}")
    body = arguments.body_options(driver_class)
    return _simulation(arguments, driver_class, _resolve(arguments, driver_class, body), body or None)


def _simulation(
    arguments: RobotArguments, driver_class: type[Driver], resolved: dict[str, Any], twin: dict[str, Any] | None
) -> Plan:
    body = arguments.body_options(driver_class)
    if ignored := [key for key in arguments.hardware_keywords() if key not in body]:
        raise TypeError(
            f"Robot: a simulation of {arguments.name} would ignore {', '.join(f'{key}=' for key in ignored)}. "
            "Add mode='real', or leave it out"
        )
    options = {"class": place_of(driver_class), "options": resolved, "gated": arguments.scene.gated}
    simulation = load(SIMULATION)
    cameras = _cameras(arguments, simulation, options)
    twin_process = TwinProcess(
        driver_class.TWIN,
        arguments.robot,
        has_control=True,
        place=arguments.scene.place,
        options=twin,
        pictures=_draws(cameras),
        backend=arguments.scene.alternative_backend,
    )
    return Plan(
        arguments.robot,
        arguments.tool_name,
        simulation,
        "",
        SIM,
        options,
        twin_process,
        data_config=arguments.data_config,
        mesh=arguments.mesh,
        lifetime_s=arguments.lifetime_s,
        cameras=cameras,
    )


def _cameras(
    arguments: RobotArguments, driver_class: type[Driver], resolved: dict[str, Any]
) -> tuple[CameraSettings, ...]:
    """Return the camera settings of a plan. Raise ``TypeError`` or ``ValueError`` if ``cameras=`` is wrong."""
    if arguments.cameras is None:
        return ()
    axes = driver_class(arguments.robot, arguments.port or "", resolved).axes
    simulated = arguments.mode == "sim" or (arguments.transport == TWIN and not driver_class.SIMULATION)
    return read_cameras(arguments.cameras, driver_class=driver_class, axes=axes, simulated=simulated)


def _draws(cameras: Iterable[CameraSettings]) -> bool:
    """Return True if one of the cameras draws the simulated scene."""
    return any(camera.type == SCENE for camera in cameras)


# -- plans for hardware, or for a simulated robot (twin)


def _real(arguments: RobotArguments, driver_class: type[Driver]) -> Plan:
    _check_hardware(arguments, driver_class)
    tool_name = arguments.tool_name
    twin_process = None
    owns_twin_process = True
    if arguments.transport == TWIN:
        owns_twin_process = arguments.sim is None
        # Leave ``tool_name`` out, so that no calibration is read. A new simulated robot has no calibration.
        resolved = _resolve(arguments, driver_class, arguments.options)
        cameras = _cameras(arguments, driver_class, resolved)
        draws = _draws(cameras)
        twin_process = (
            TwinProcess(
                driver_class.TWIN,
                arguments.robot,
                has_control=draws,
                options=arguments.body_options(driver_class) or None,
                pictures=draws,
                on_wire=draws,
            )
            if owns_twin_process
            else _twin_process_of(arguments, driver_class)
        )
    else:
        transport = {} if arguments.transport is None else {"transport": arguments.transport}
        resolved = _resolve(arguments, driver_class, {**arguments.options, **transport, "tool_name": tool_name})
        _check_port(arguments, driver_class, resolved)
        cameras = _cameras(arguments, driver_class, resolved)
    return Plan(
        arguments.robot,
        tool_name,
        driver_class,
        arguments.port or "",
        arguments.transport,
        resolved,
        twin_process,
        owns_twin_process,
        arguments.data_config,
        arguments.mesh,
        arguments.drill_age_s,
        lifetime_s=arguments.lifetime_s,
        cameras=cameras,
        policy_limits=arguments.policy_limits,
    )


def _elsewhere(arguments: RobotArguments, driver_class: type[Driver]) -> Plan:
    """Return the plan for a robot of another host. That host has the arguments for the hardware."""
    assert arguments.host_address is not None
    _leave_to_host(arguments)
    return Plan(
        arguments.robot,
        arguments.tool_name,
        driver_class,
        "",
        None,
        _resolve(arguments, driver_class, arguments.options),
        data_config=arguments.data_config,
        mesh=arguments.mesh,
        host_address=arguments.host_address,
        lifetime_s=arguments.lifetime_s,
        policy_limits=arguments.policy_limits,
    )


def _plain(arguments: RobotArguments, driver_class: type[Any]) -> Plan:
    """Return the plan for a plain driver class, which is not made for this package.

    Such a class comes from the drivers page of strands-robots, or from LeRobot.
    """
    name = driver_class.__name__
    if arguments.mode == "sim":
        raise ValueError(f"Robot: {name} has no simulation of {arguments.name}. Use mode='real'")
    if arguments.sim is not None or arguments.transport == "twin":
        raise ValueError(f"Robot: this package has no simulated robot for {name}. Give the port of the real robot")
    if arguments.host_address is None:
        _check_hardware(arguments, driver_class)
    else:
        _leave_to_host(arguments)
    own = {"port": arguments.port, "transport": arguments.transport, "cameras": arguments.cameras}
    own |= {"tool_name": arguments.tool_name, "data_config": arguments.data_config}
    values = {key: value for key, value in own.items() if value is not None} | arguments.options
    plain = load(getattr(driver_class, "DRIVER", PLAIN))
    options = plain.options_of(driver_class, arguments.robot, values)
    if arguments.host_address is not None and not plain(arguments.robot, "", options).axes:
        raise ValueError(
            f"Robot: the axes of {name} are not known before an object of it is made. To reach it at "
            f"{arguments.host_address}, give the class a mapping of its keys as action_features"
        )
    return Plan(
        arguments.robot,
        arguments.tool_name,
        plain,
        arguments.port or "",
        None,
        options,
        data_config=arguments.data_config,
        mesh=arguments.mesh,
        drill_age_s=arguments.drill_age_s,
        host_address=arguments.host_address or "",
        lifetime_s=arguments.lifetime_s,
        policy_limits=arguments.policy_limits,
    )


def _leave_to_host(arguments: RobotArguments) -> None:
    """Raise ``TypeError`` for a keyword that only the host of the robot can use."""
    own = ("port", "transport", "sim", "cameras", "require_drill")
    keywords = arguments.hardware_keywords() | ({} if arguments.cameras is None else {"cameras": arguments.cameras})
    ignored = [key for key in keywords if key in own]
    if arguments.policy_limits != PolicyLimits():
        ignored.append("policy_limits")
    if ignored:
        raise TypeError(
            f"Robot: only the host at {arguments.host_address} can set "
            f"{', '.join(f'{key}=' for key in ignored)}. Leave that out"
        )


def _check_hardware(arguments: RobotArguments, driver_class: type[Any]) -> None:
    name, transport = driver_name(driver_class), arguments.transport
    offered = tuple(getattr(driver_class, "TRANSPORTS", ()))
    if transport is not None and transport not in offered:
        words = (*offered, "serial") if is_serial(driver_class) else offered
        raise ValueError(
            f"Robot: {name} has no transport {transport!r}. "
            f"It offers {', '.join(words) or 'no transport, so leave transport= out'}"
        )
    if arguments.sim is not None and transport != TWIN:
        raise ValueError(
            "Robot: sim= is used only with transport='twin'. Add it, or leave out sim=. "
            f"{name} offers {', '.join(offered) or 'no transport'}"
        )
    is_plain = not issubclass(driver_class, Driver)
    if arguments.cameras and is_plain and not getattr(driver_class, "reads_cameras", False):
        raise ValueError(f"Robot: {name} opens no cameras. Leave out cameras=, and read them in your program")
    if transport == TWIN and arguments.port is not None:
        raise ValueError(
            f"Robot: port={arguments.port!r} and transport={transport!r} are both given. Give one of them"
        )
    needs_port = hasattr(driver_class, "PORT_KIND") and not getattr(driver_class, "PORT_OPTIONAL", False)
    if transport is None and arguments.port is None and needs_port:
        raise ValueError(_missing_port(arguments.robot, driver_class))


def _resolve(arguments: RobotArguments, driver_class: type[Driver], options: dict[str, Any]) -> dict[str, Any]:
    """Return the options as the driver reads them.

    If the user gave an option by another name, the text of an error has that name, too.
    """
    try:
        return driver_class.resolve(arguments.robot, options)
    except (TypeError, ValueError) as refusal:
        if not arguments.spelled:
            raise
        names = ", ".join(f"{spelling} is another name of {own}" for own, spelling in arguments.spelled.items())
        error_class = ValueError if isinstance(refusal, ValueError) else TypeError
        raise error_class(f"{refusal} ({names})") from None


def _check_port(arguments: RobotArguments, driver_class: type[Driver], resolved: dict[str, Any]) -> None:
    driver = driver_class(arguments.robot, arguments.port or "", resolved)
    try:
        driver.check_port()
    except ValueError as refusal:
        raise ValueError(f"Robot: {arguments.robot}: {refusal}") from None


def _twin_process_of(arguments: RobotArguments, driver_class: type[Driver]) -> TwinProcess:
    twin_process = getattr(arguments.sim, "twin_process", None)
    if getattr(arguments.sim, "transport", None) != SIM or not isinstance(twin_process, TwinProcess):
        raise ValueError(f"Robot: sim is {arguments.sim!r}. Give a simulation, such as Robot({arguments.robot!r})")
    if twin_process.robot != arguments.robot:
        raise ValueError(
            f"Robot: sim is a simulation of {twin_process.robot}. Give a simulation of {arguments.robot}"
        )
    body = arguments.body_options(driver_class)
    for key in driver_class.TWIN_OPTIONS:
        if body.get(key) != twin_process.options.get(key):
            raise ValueError(
                f"Robot: {key} is {body.get(key)!r}, and {twin_process.options.get(key)!r} in the simulation. "
                "Give both the same"
            )
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
        f"Serial devices here: {devices}{doubt} (a path is not an identity: check which robot is behind it)"
    )

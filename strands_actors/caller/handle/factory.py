"""The function ``Robot(...)``, which makes the handle of one robot, real or simulated.

The handle has the methods and results that the drivers page of strands-robots describes.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from strands_actors.surfaces.agents.approval import APPROVE_S, Approve, approval_of

from ..processes.twin_process import SIM
from ..resolve.planning import plan
from .real_robot import RealRobot
from .sim_robot import SimRobot

if TYPE_CHECKING:
    from strands_actors.surfaces.mesh.config import MeshConfig


# This is a function. It has the name of a class because strands-robots names it so.
def Robot(
    name: str,
    mode: str = "sim",
    *,
    driver: str = "auto",
    port: str | os.PathLike[str] | None = None,
    transport: str | None = None,
    sim: SimRobot | None = None,
    id: str | None = None,  # the name of this parameter in LeRobot
    tool_name: str | None = None,
    peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None,
    data_config: Any = None,
    mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None,
    at: str | None = None,
    lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None,
    backend: str = "mujoco",
    urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None,
    gated: bool = True,
    onboard: str | os.PathLike[str] | None = None,
    attach: bool = False,
    arm: bool = True,
    approve: Approve | None = None,
    guarded: tuple[str, ...] = (),
    approve_within_s: float = APPROVE_S,
    **options: Any,
) -> RealRobot:
    """Return the handle of one robot. Nothing is started yet.

    A simulation starts at its first use. A real robot is connected by ``connect_eagerly()``, by a
    ``with`` block, or by its first command.

    Args:
        name: Name of the robot. ``list_robots()`` has all names.
        mode: ``"sim"``: a simulation. ``"real"``: hardware, or a simulated robot that speaks the protocol of
            the hardware. ``"auto"``: real if a port or a transport is given; otherwise the value of
            ``STRANDS_ROBOT_MODE``; otherwise real if exactly one serial adapter of the robot's kind is plugged
            in, else a simulation.
        driver: ``"auto"``, ``"strands"``, ``"lerobot"``, or ``"ros2"`` for a node of a ROS 2 graph, with
            ``table``.
        port: Serial device or address of the real robot.
        transport: ``"twin"``: in place of a port, start a simulated robot (twin) that speaks the real protocol.
            A driver may offer other transports.
        sim: A simulation of the same robot that the real driver connects to (with ``transport="twin"``).
        id: Id of this robot: its name on this computer, on the mesh and for agents, and the name of its calibration
            file. 1 to 64 of A-Z a-z 0-9 _ -. None: the name of the robot.
        tool_name: The same as ``id``, under its name in strands-robots.
        peer_id: The same as ``id``, under its name in strands-robots.
        cameras: Camera settings by camera name, with LeRobot's keys. For a simulated robot ``{"wrist": {},
            "front": {}}`` gives drawn pictures.
        data_config: Kept unchanged for code that builds a policy.
        mesh: The address at which other hosts reach the robot (``MeshConfig``). False: other hosts
            cannot reach it. None: ``MeshConfig`` from the environment.
        require_drill: Refuse motion unless a stop drill was passed within this time, such as ``"30d"``.
        at: The address of another host that runs the robot, such as ``"tls/arm.example:7447"``. Then
            ``mesh`` has the certificate, and ``id`` is the robot's id there.
        lifetime: Least lifetime of a streamed setpoint in seconds, for a slow network or a busy computer.
        policy_limits: Limits of the process of a named policy: ``memory_mb``, ``cpu_s``,
            ``processors``, ``user``.
        backend: Physics of a simulation: ``"mujoco"``, ``"newton"`` or ``"isaac"``.
        urdf_path: An MJCF or URDF file to simulate under this name.
        position: Position of the simulated base, in metres.
        orientation: Orientation of the simulated base, a quaternion w, x, y, z.
        keyframe: The keyframe of the model in which the simulation begins and holds.
        gated: False lets a target of a simulation exceed the range of its joint.
        onboard: Folder of an ONNX policy that moves the joints of a simulated model (``urdf_path``) whenever they
            would only hold. It keeps a robot with legs standing.
        attach: True: ``name`` is a robot that a host of this user keeps (``strands-actors up``). The handle
            connects to it. The host has the other settings, so only ``arm``, ``approve``, ``guarded`` and
            ``approve_within_s`` may be given. The robot's processes outlive the handle and this program.
        arm: False: a connect energises nothing. The robot can be read and moved by hand until
            ``resume()``.
        approve: Function that gives the approval of an operator. It is called before an agent, or
            another program, uses a guarded verb or action key. It returns True to approve.
        guarded: Verbs and action keys that are guarded, in addition to those of the driver.
        approve_within_s: Longest time in seconds that ``approve`` may take. After it the request is
            refused.
        options: Options of the driver.

    Returns:
        A ``SimRobot`` for a simulation, otherwise a ``RealRobot``.

    Raises:
        ValueError: A name, a value or a keyword is wrong. The text lists the accepted ones.
        TypeError: A value has the wrong type, or the mode would ignore the keyword.
        ImportError: The package of the ``backend`` is not installed.
        ConnectionError: With ``attach``: no host keeps such a robot now.

    Example:
        with Robot("so101", mode="real", port="/dev/ttyACM0") as arm:
            arm.move_to({"shoulder_pan": 10.0}, seconds=2.0)
    """
    keywords = {
        "driver": driver,
        "port": port,
        "transport": transport,
        "sim": sim,
        "id": id,
        "tool_name": tool_name,
        "peer_id": peer_id,
        "cameras": cameras,
        "data_config": data_config,
        "mesh": mesh,
        "require_drill": require_drill,
        "at": at,
        "lifetime": lifetime,
        "policy_limits": policy_limits,
        "backend": backend,
        "urdf_path": urdf_path,
        "position": position,
        "orientation": orientation,
        "keyframe": keyframe,
        "gated": gated,
        "onboard": onboard,
        **options,
    }
    if attach is not False:
        if attach is not True:
            raise TypeError(
                f"Robot: attach is {attach!r}. Give True for a robot that a host keeps, or leave it out"
            )
        # Only a handle of a host's robot needs these imports.
        from ..session.portal import portal
        from .attaching import attachment

        given = _given({"mode": mode, **keywords})
        parts = portal().call(attachment, name, given, arm, approve, guarded, approve_within_s)
        return RealRobot(*parts)
    robot_plan = plan(name, mode, **keywords)
    approval = approval_of(robot_plan.driver_class, guarded, approve, approve_within_s)
    return (SimRobot if robot_plan.transport == SIM else RealRobot)(robot_plan, approval, arm)


def _given(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords that differ from their defaults."""
    defaults = {name: each.default for name, each in inspect.signature(Robot).parameters.items()}
    return {name: value for name, value in keywords.items() if name not in defaults or value != defaults[name]}

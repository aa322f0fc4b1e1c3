"""``Robot(...)``: a handle on one robot, real or simulated. Its verbs and envelopes are those of the
drivers page."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from strands_actors.surfaces.agents.approval import APPROVE_S, Approve, approval_of

from .plan import plan
from .real_robot import RealRobot
from .sim_robot import SimRobot
from .twin_process import SIM

if TYPE_CHECKING:
    from strands_actors.surfaces.mesh.config import MeshConfig


def Robot(  # a factory named as on the drivers page
    name: str,
    mode: str = "sim",
    *,
    driver: str = "auto",
    port: str | os.PathLike[str] | None = None,
    transport: str | None = None,
    sim: SimRobot | None = None,
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
    arm: bool = True,
    approve: Approve | None = None,
    guarded: tuple[str, ...] = (),
    approve_within_s: float = APPROVE_S,
    **options: Any,
) -> RealRobot:
    """Return a handle on one robot; nothing is started yet.

    ``mode``: ``"sim"``, a simulation, which starts at its first use; ``"real"``, a robot, connected
    by ``connect_eagerly()``; ``"auto"``, real when a port or a transport is given, what
    ``STRANDS_ROBOT_MODE`` says, or real when exactly one serial adapter of the robot's kind is
    plugged in, else a simulation. ``port`` says where a
    real robot is; ``transport="twin"`` puts its twin behind its real wire instead, and ``sim=``
    makes that twin a simulation you have. ``at``: the robot is run by another host, which listens
    there (``"tls/arm.example:7447"``); ``mesh=`` has the certificate, ``tool_name`` its name there,
    and ``lifetime`` (seconds) is how long a setpoint of a rollout lives on a slow network.
    ``peer_id`` is another word for ``tool_name``.
    ``driver``: ``"auto"``, ``"strands"`` or ``"lerobot"``. ``cameras``: by name, settings in
    LeRobot's words; a twin or a simulation has ``{"wrist": {}, "front": {}}``. ``data_config`` is
    kept for who builds a policy. ``approve`` is asked, for at most ``approve_within_s``, before an
    agent (or who else is not this program) uses a verb or an action key that is guarded: by the
    driver, or by ``guarded``. ``require_drill``: no motion without a stop drill that is younger
    (``"30d"``). ``mesh``: where other hosts reach it; False: nowhere. ``policy_limits``: what the
    process of a named policy may use (``memory_mb``, ``cpu_s``, ``processors``, ``user``). Of a
    simulation: ``urdf_path``, an MJCF or URDF file that is simulated under this name; ``position``
    (metres) and ``orientation`` (quaternion w, x, y, z) of its base, and the ``keyframe`` of its
    model in which it begins and holds; ``gated=False`` lets a target be past the range of its joint;
    ``backend``, ``"mujoco"``, ``"newton"`` or ``"isaac"``. ``arm=False``:
    connecting energises nothing, and until ``resume()`` the robot may be moved by hand and read.
    ``options`` are the driver's own. Raise ``ValueError`` or ``TypeError`` with what would be accepted.
    """
    wanted = plan(
        name,
        mode,
        driver=driver,
        port=port,
        transport=transport,
        sim=sim,
        tool_name=tool_name,
        peer_id=peer_id,
        cameras=cameras,
        data_config=data_config,
        mesh=mesh,
        require_drill=require_drill,
        at=at,
        lifetime=lifetime,
        policy_limits=policy_limits,
        backend=backend,
        urdf_path=urdf_path,
        position=position,
        orientation=orientation,
        keyframe=keyframe,
        gated=gated,
        **options,
    )
    approval = approval_of(wanted.driver_class, guarded, approve, approve_within_s)
    return (SimRobot if wanted.transport == SIM else RealRobot)(wanted, approval, arm)

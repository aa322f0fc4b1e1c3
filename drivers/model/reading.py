"""Read a user's model, MJCF or URDF, as a body with a position servo at each axis.

If the model has actuators, an axis is a joint that an actuator drives, directly or as the first joint of a tendon.
If it has no actuators, every hinge and slide is an axis, except joints that follow another joint; gravity is then
compensated by a force on each link. Position actuators of the model keep their gains. All other actuators become
servos with gains that follow from the model's mass.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from strands_actors.contract.lfs import pointer_reason
from strands_actors.drivers.common.codecs.xml_text import Element, NotXml, parse
from strands_actors.drivers.common.physics.body import TIMESTEP_S
from strands_actors.drivers.common.physics.lean_mujoco import PLAIN, mujoco

from .files import pointer_among, refuse_sizes
from .floor import add_floor
from .urdf import OmittedVisual, readable_urdf

REFUSALS = (ValueError, RuntimeError, MemoryError, mujoco.FatalError)
"""The exceptions that MuJoCo raises for a model that it cannot use."""


class Joint(NamedTuple):
    """One axis of the model. ``kp`` is 0 if the file has no gains; ``Plant`` then chooses them."""

    name: str
    low: float
    high: float
    slides: bool
    kp: float
    kv: float
    effort: float  # largest force or torque of the joint; infinite if the model has no limit


class Read(NamedTuple):
    spec: Any
    joints: tuple[Joint, ...]
    keyframes: dict[str, tuple[float, ...]]  # for each keyframe's name, the ``qpos`` of the whole model
    omitted_visuals: tuple[OmittedVisual, ...] = ()


def read_model(path: str | Path) -> Read:
    """Read a model file and replace its actuators by position servos.

    Raises:
        ValueError: The file cannot be used. The message has the reason.
    """
    place = Path(path).expanduser().resolve()
    spec, own, omitted = _load(place)
    try:
        keyframes = _keyframes(spec, own)
        joints = _drive(spec, own)
        model = spec.compile()
    except REFUSALS as error:
        raise _refused(place, error) from None
    if not joints:
        raise ValueError(f"{place} has no joint that can be driven. Add a hinge or a slide joint")
    add_floor(spec, model)
    return Read(spec, joints, keyframes, omitted)


def _load(place: Path) -> tuple[Any, Any, tuple[OmittedVisual, ...]]:
    """Return the editable model, the compiled model, and the visual shapes that were left out."""
    if not place.is_file():
        raise ValueError(f"there is no model {place}. Give an MJCF or a URDF file")
    if place.suffix.lower() == ".xacro":
        raise ValueError(f"{place} is a xacro. Expand it first: xacro {place.name} > {place.stem}")
    if reason := pointer_reason(place):
        raise ValueError(reason)
    text = place.read_bytes().decode("utf-8-sig", "replace")
    try:
        root = parse(text)
    except NotXml as error:
        raise ValueError(f"{place} is no valid XML: {error}") from None
    if root.tag.lower() == "robot":
        return _load_urdf(place, text, root)
    if root.tag.lower() != "mujoco":
        raise ValueError(f"{place} is no URDF or MJCF, since it begins with <{root.tag}>")
    try:
        refuse_sizes(root)
        spec = mujoco.MjSpec.from_file(str(place))
    except REFUSALS as error:
        raise _refused(place, error) from None
    _name_joints(spec)
    try:
        return spec, spec.copy().compile(), ()
    except REFUSALS as error:
        raise ValueError(pointer_among(spec, place.parent) or _refused(place, error)) from None


def _load_urdf(place: Path, text: str, root: Element) -> tuple[Any, Any, tuple[OmittedVisual, ...]]:
    """Read a URDF; the result is that of ``_load``. Visual shapes with a mesh that MuJoCo cannot read are left out,
    so that they do not make the whole file unusable."""
    unreadable: tuple[Path, ...] = ()
    while True:
        urdf = readable_urdf(place, text, root, unreadable)
        try:
            spec = mujoco.MjSpec.from_string(urdf.text)
            _name_joints(spec)
            model = spec.copy().compile()
            exclude_neighbours_of_base(spec, model)
            return spec, model, urdf.omitted_visuals
        except REFUSALS as error:
            rejected = tuple(mesh for mesh in dict.fromkeys(urdf.visuals) if not _reads(mesh))
            if not rejected or unreadable:
                raise _refused(place, error) from None
            unreadable = rejected


def _reads(mesh: Path) -> bool:
    """Return True if MuJoCo can read this mesh."""
    spec = mujoco.MjSpec()
    spec.add_mesh(name="mesh", file=str(mesh))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh", contype=0, conaffinity=0)
    try:
        spec.compile()
    except REFUSALS:
        return False
    return True


def exclude_neighbours_of_base(spec: Any, model: Any) -> None:
    """Let the fixed base of a URDF and the links that are joined to it pass through each other.

    MuJoCo ignores contacts between a link and its parent, but not if the parent is fixed to the world, since a ball
    must not fall through the ground. In a URDF the fixed part is the robot's base, and its shapes overlap with the
    next link at the joint.
    """
    shaped = [body for body in range(model.nbody) if model.body_geomnum[body]]
    still = [body for body in shaped if model.body_weldid[body] == 0]
    for body in shaped:
        moves = int(model.body_weldid[body])
        if moves and model.body_weldid[model.body_parentid[moves]] == 0:
            for base in still:
                spec.add_exclude(bodyname1=model.body(base).name, bodyname2=model.body(body).name)


def _refused(place: Path, error: Exception) -> ValueError:
    """Return an error with MuJoCo's text and the path of the user's file."""
    if isinstance(error, MemoryError) or type(error) is RuntimeError:
        return ValueError(f"{place}: the model is too large for this computer's memory. Give a smaller model")
    text = " ".join(str(error).split())
    return ValueError(text if text.startswith(str(place)) else f"{place}: MuJoCo cannot read this model: {text}")


def _name_joints(spec: Any) -> None:
    """Give a name to each joint without one, since an axis needs a name."""
    names = {joint.name for joint in spec.joints}
    for index, joint in enumerate(spec.joints):
        if not joint.name and _turns(joint):
            joint.name = _free_name(f"joint{index}", names)
            names.add(joint.name)


def _keyframes(spec: Any, model: Any) -> dict[str, tuple[float, ...]]:
    """Return the joint positions of each keyframe. The key is the keyframe's name, or its number if it has no name.
    The keyframe's values for actuators are dropped, since the actuators are replaced."""
    positions = {}
    for index, key in enumerate(spec.keys):
        positions[key.name or str(index)] = tuple(model.key_qpos[index].tolist())
        key.ctrl, key.act = [], []
    return positions


def _drive(spec: Any, model: Any) -> tuple[Joint, ...]:
    """Replace the actuators of the model by position servos.

    Args:
        spec: The user's model. It is changed.
        model: The compiled model, in which damping ratios, gains of defaults and ranges in degrees are
            numbers in SI units.

    Returns:
        The axes, in the model's order.
    """
    spec.option.timestep = TIMESTEP_S
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_EULER:
        # Stiff servos do not oscillate with this integrator.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    by_name = {joint.name: joint for joint in spec.joints if _turns(joint)}
    actuators: dict[str, list[tuple[int, Any]]] = {}
    for index, actuator in enumerate(spec.actuators):
        actuators.setdefault(_target(spec, actuator), []).append((index, actuator))
    actuators = {name: pairs for name, pairs in actuators.items() if name in by_name}
    follower_joints = {equality.name1 for equality in spec.equalities if _couples(equality)}
    if not actuators:
        actuators = {name: [] for name in by_name if name not in follower_joints}
        # The model declares no actuators: compensate gravity, as the robot's own controller would.
        for body in spec.bodies[1:]:
            body.gravcomp = 1.0
    gains = {name: _gains(model, model.joint(name).id, pairs) for name, pairs in actuators.items()}
    for _, actuator in (pair for pairs in actuators.values() for pair in pairs):
        _forget(spec, actuator)
    names = {actuator.name for actuator in spec.actuators}
    joints = []
    for name, joint in by_name.items():
        if name not in gains:
            continue
        kp, kv, effort = gains[name]
        index = model.joint(name).id
        low, high = model.jnt_range[index].tolist() if model.jnt_limited[index] else (-math.inf, math.inf)
        joints.append(Joint(name, low, high, joint.type == mujoco.mjtJoint.mjJNT_SLIDE, kp, kv, effort))
        servo = spec.add_actuator(
            default=PLAIN.default, name=_free_name(name, names), trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name
        )
        names.add(servo.name)
        servo.set_to_position(kp=kp or 1.0, kv=kv)
        if math.isfinite(effort):
            servo.forcelimited, servo.forcerange = True, [-effort, effort]
    return tuple(joints)


def _turns(joint: Any) -> bool:
    return joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def _couples(equality: Any) -> bool:
    return bool(equality.type == mujoco.mjtEq.mjEQ_JOINT and equality.name2 and equality.active)


def _target(spec: Any, actuator: Any) -> str:
    """Return the name of the joint that an actuator drives; empty if it drives something else. For a tendon, return
    the first joint of the tendon."""
    kinds = mujoco.mjtTrn
    if actuator.trntype in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
        return str(actuator.target)
    if actuator.trntype != kinds.mjTRN_TENDON:
        return ""
    tendon = spec.tendon(actuator.target)
    joints = [wrap.target.name for wrap in tendon.path if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT]
    return joints[0] if joints else ""


def _gains(model: Any, joint: int, actuators: Sequence[tuple[int, Any]]) -> tuple[float, float, float]:
    """Return kp, kv and the largest force of the model's own position servo at a joint.

    MuJoCo's force is ``gain * control + bias[0] + bias[1] * length + bias[2] * speed``. So the stiffness at the
    joint is ``-bias[1]``. The gain only scales the control input (0 to 255), and this input is replaced. A velocity
    actuator at the same joint gives the damping of the servo.
    """
    kinds = mujoco.mjtTrn
    joint_actuators = [
        pair for pair in actuators if pair[1].trntype in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT)
    ]
    biased = [pair for pair in joint_actuators if pair[1].biastype == mujoco.mjtBias.mjBIAS_AFFINE]
    servos = [pair for pair in biased if model.actuator_biasprm[pair[0], 1] < 0 and pair[1].gear[0]]
    kp, kv = (
        sum(-float(model.actuator_biasprm[index, row]) * float(actuator.gear[0]) ** 2 for index, actuator in biased)
        if servos
        else 0.0
        for row in (1, 2)
    )
    effort = sum(_effort(actuator) for _, actuator in servos or joint_actuators) or math.inf
    if model.jnt_actfrclimited[joint]:
        effort = min(effort, float(abs(model.jnt_actfrcrange[joint]).max()))
    return kp, max(kv, 0.0), effort


def _effort(actuator: Any) -> float:
    """Return the largest force of an actuator at its joint, in the stronger direction; infinite if the model has no
    limit."""
    gear = abs(float(actuator.gear[0]))
    effort = math.inf
    if actuator.forcerange[0] < actuator.forcerange[1]:
        effort = float(abs(actuator.forcerange).max()) * (gear or 1.0)
    is_motor = (actuator.biastype, actuator.gaintype) == (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtGain.mjGAIN_FIXED)
    if is_motor and actuator.ctrlrange[0] < actuator.ctrlrange[1]:
        effort = min(effort, float(abs(actuator.ctrlrange).max()) * gear * abs(float(actuator.gainprm[0])))
    return effort


def _forget(spec: Any, actuator: Any) -> None:
    """Remove an actuator, and the sensors that measure it."""
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname == actuator.name:
            spec.delete(sensor)
    spec.delete(actuator)


def _free_name(name: str, names: Iterable[str]) -> str:
    while name in names:
        name += "_"
    return name

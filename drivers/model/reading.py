"""Read a user's model, MJCF or URDF, as a body with a position servo at each axis.

If the model has actuators, an axis is a joint that an actuator drives, directly or as the first joint of a
tendon. If it has no actuators, every hinge and slide is an axis, except joints that follow another joint;
gravity is then compensated. Position actuators of the model keep their gains. All other actuators become
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
from .urdf import LeftOut, readable_urdf

REFUSALS = (ValueError, RuntimeError, MemoryError, mujoco.FatalError)
"""The exceptions that MuJoCo raises for a model that it cannot use."""


class Joint(NamedTuple):
    """An axis of the model. ``kp`` is 0 where the plant has to choose the gains."""

    name: str
    low: float
    high: float
    slides: bool
    kp: float
    kv: float
    effort: float  # infinite if the model has no limit


class Read(NamedTuple):
    spec: Any
    joints: tuple[Joint, ...]
    keyframes: dict[str, tuple[float, ...]]  # by name: ``qpos`` of the whole model
    left_out: tuple[LeftOut, ...] = ()


def read_model(path: str | Path) -> Read:
    """Read a model file and replace its actuators by position servos.

    Raises:
        ValueError: The file cannot be used. The text says why.
    """
    place = Path(path).expanduser().resolve()
    spec, own, left_out = _load(place)
    try:
        keyframes = _keyframes(spec, own)
        joints = _drive(spec, own)
        model = spec.compile()
    except REFUSALS as error:
        raise _refused(place, error) from None
    if not joints:
        raise ValueError(f"{place} has no joint that can be driven. a hinge or a slide is needed")
    add_floor(spec, model)
    return Read(spec, joints, keyframes, left_out)


def _load(place: Path) -> tuple[Any, Any, tuple[LeftOut, ...]]:
    """Return the editable model, the compiled model, and the shapes that were left out."""
    if not place.is_file():
        raise ValueError(f"there is no model {place}. give an MJCF or a URDF file")
    if place.suffix.lower() == ".xacro":
        raise ValueError(f"{place} is a xacro. expand it first: xacro {place.name} > {place.stem}")
    if why := pointer_reason(place):
        raise ValueError(why)
    text = place.read_bytes().decode("utf-8-sig", "replace")
    try:
        root = parse(text)
    except NotXml as error:
        raise ValueError(f"{place} is no XML: {error}") from None
    if root.tag.lower() == "robot":
        return _load_urdf(place, text, root)
    if root.tag.lower() != "mujoco":
        raise ValueError(f"{place} is no URDF or MJCF: it begins with <{root.tag}>")
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


def _load_urdf(place: Path, text: str, root: Element) -> tuple[Any, Any, tuple[LeftOut, ...]]:
    """As ``_load``. Visual meshes that MuJoCo refuses are left out, since MuJoCo alone would not read them."""
    unreadable: tuple[Path, ...] = ()
    while True:
        urdf = readable_urdf(place, text, root, unreadable)
        try:
            spec = mujoco.MjSpec.from_string(urdf.text)
            _name_joints(spec)
            model = spec.copy().compile()
            exclude_neighbours_of_base(spec, model)
            return spec, model, urdf.left_out
        except REFUSALS as error:
            rejected = tuple(mesh for mesh in dict.fromkeys(urdf.visuals) if not _reads(mesh))
            if not rejected or unreadable:
                raise _refused(place, error) from None
            unreadable = rejected


def _reads(mesh: Path) -> bool:
    """Return True if MuJoCo accepts this mesh."""
    spec = mujoco.MjSpec()
    spec.add_mesh(name="mesh", file=str(mesh))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh", contype=0, conaffinity=0)
    try:
        spec.compile()
    except REFUSALS:
        return False
    return True


def exclude_neighbours_of_base(spec: Any, model: Any) -> None:
    """Let the base of a URDF and the links at it pass through each other.

    MuJoCo lets a link pass through its parent, unless the parent is fixed to the world: a ball must not
    fall through the ground. In a URDF the fixed part is the robot's own base, and its shapes overlap with
    the next link at the joint. Pairs that MuJoCo excludes anyway do not change.
    """
    shaped = [body for body in range(model.nbody) if model.body_geomnum[body]]
    still = [body for body in shaped if model.body_weldid[body] == 0]
    for body in shaped:
        moves = int(model.body_weldid[body])
        if moves and model.body_weldid[model.body_parentid[moves]] == 0:
            for base in still:
                spec.add_exclude(bodyname1=model.body(base).name, bodyname2=model.body(body).name)


def _refused(place: Path, error: Exception) -> ValueError:
    """Return MuJoCo's error with the name of the user's file."""
    if isinstance(error, MemoryError) or type(error) is RuntimeError:
        return ValueError(f"{place}: MuJoCo cannot hold it: it is too large for this computer's memory")
    text = " ".join(str(error).split())
    return ValueError(text if text.startswith(str(place)) else f"{place}: MuJoCo does not take it: {text}")


def _name_joints(spec: Any) -> None:
    """Give a name to each joint without one, since an axis needs a name."""
    taken = {joint.name for joint in spec.joints}
    for at, joint in enumerate(spec.joints):
        if not joint.name and _turns(joint):
            joint.name = _free_name(f"joint{at}", taken)
            taken.add(joint.name)


def _keyframes(spec: Any, model: Any) -> dict[str, tuple[float, ...]]:
    """Return the positions of each keyframe, by its name, or by its number if it has no name. Its values for
    actuators are dropped, since the actuators are replaced."""
    positions = {}
    for at, key in enumerate(spec.keys):
        positions[key.name or str(at)] = tuple(model.key_qpos[at].tolist())
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
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # stiff servos stay calm in it
    by_name = {joint.name: joint for joint in spec.joints if _turns(joint)}
    actuators: dict[str, list[tuple[int, Any]]] = {}
    for at, actuator in enumerate(spec.actuators):
        actuators.setdefault(_target(spec, actuator), []).append((at, actuator))
    actuators = {name: pairs for name, pairs in actuators.items() if name in by_name}
    led = {equality.name1 for equality in spec.equalities if _couples(equality)}
    if not actuators:
        actuators = {name: [] for name in by_name if name not in led}
        # The model declares no actuators: compensate gravity, as its controller would.
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
        at = model.joint(name).id
        low, high = model.jnt_range[at].tolist() if model.jnt_limited[at] else (-math.inf, math.inf)
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
    """Return the joint that an actuator drives; empty if it drives something else. A tendon counts as the
    first joint that it runs over."""
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

    A force is ``gain * control + bias[0] + bias[1] * length + bias[2] * speed``, so the stiffness at the
    joint follows from the bias. The gain only scales the control (0 to 255), which is replaced. A velocity
    actuator at the same joint is the damping of the servo.
    """
    kinds = mujoco.mjtTrn
    at_joint = [pair for pair in actuators if pair[1].trntype in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT)]
    biased = [pair for pair in at_joint if pair[1].biastype == mujoco.mjtBias.mjBIAS_AFFINE]
    servos = [pair for pair in biased if model.actuator_biasprm[pair[0], 1] < 0 and pair[1].gear[0]]
    kp, kv = (
        sum(-float(model.actuator_biasprm[at, row]) * float(actuator.gear[0]) ** 2 for at, actuator in biased)
        if servos
        else 0.0
        for row in (1, 2)
    )
    effort = sum(_effort(actuator) for _, actuator in servos or at_joint) or math.inf
    if model.jnt_actfrclimited[joint]:
        effort = min(effort, float(abs(model.jnt_actfrcrange[joint]).max()))
    return kp, max(kv, 0.0), effort


def _effort(actuator: Any) -> float:
    """Return the largest force of an actuator at its joint, in the stronger direction; infinite without a
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


def _free_name(name: str, taken: Iterable[str]) -> str:
    while name in taken:
        name += "_"
    return name

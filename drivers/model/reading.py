"""A model of a user's own, MJCF or URDF, as a body with a position servo at each of its joints.

An axis is a joint that the model drives, by an actuator or by a tendon's first joint; in a model
without actuators every hinge and slide that no other joint leads, and gravity is made up for. The
model's own position actuators keep their gains; all others become servos, whose gains follow from
the model's mass.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

from strands_actors.drivers.common.lean_mujoco import mujoco
from strands_actors.drivers.common.simulation_control.protocol import TIMESTEP_S

from .urdf import readable_urdf


class Joint(NamedTuple):
    """An axis of the model. ``kp`` is 0 where the servo's gains are the plant's business."""

    name: str
    low: float
    high: float
    slides: bool
    kp: float
    kv: float
    effort: float  # infinite: the model has no limit


class Read(NamedTuple):
    spec: Any
    joints: tuple[Joint, ...]
    keyframes: dict[str, tuple[float, ...]]  # by name: the position of each joint


def read_model(path: str | Path) -> Read:
    """Raise ``ValueError`` that says what is wrong with the file."""
    place = Path(path).expanduser().resolve()
    spec = _load(place)
    try:
        keyframes = _keyframes(spec)
        joints = _drive(spec)
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise ValueError(f"{place}: MuJoCo does not take it: {' '.join(str(error).split())}") from None
    if not joints:
        raise ValueError(f"{place} has no joint that can be driven. a hinge or a slide is needed")
    named = {
        name: tuple(float(qpos[model.jnt_qposadr[model.joint(joint.name).id]]) for joint in joints)
        for name, qpos in keyframes.items()
        if len(qpos) == model.nq
    }
    return Read(spec, joints, named)


def _load(place: Path) -> Any:
    if not place.is_file():
        raise ValueError(f"there is no model {place}. give an MJCF or a URDF file")
    if place.suffix.lower() == ".xacro":
        raise ValueError(f"{place} is a xacro. expand it first: xacro {place.name} > {place.stem}")
    is_urdf = place.suffix.lower() == ".urdf" or "<robot" in place.read_text(errors="replace")[:4096]
    try:
        if is_urdf:
            text, meshes = readable_urdf(place)
            return mujoco.MjSpec.from_string(text, assets=meshes)
        return mujoco.MjSpec.from_file(str(place))
    except (ValueError, mujoco.FatalError) as error:
        text = " ".join(str(error).split())
        raise ValueError(
            text if text.startswith(str(place)) else f"{place}: MuJoCo does not take it: {text}"
        ) from None


def _keyframes(spec: Any) -> dict[str, tuple[float, ...]]:
    """By name, and by number where one has none. What they say of actuators is dropped: those are
    exchanged."""
    found = {}
    for at, key in enumerate(spec.keys):
        found[key.name or str(at)] = tuple(float(value) for value in key.qpos)
        key.ctrl, key.act = [], []
    return found


def _drive(spec: Any) -> tuple[Joint, ...]:
    """Exchange what drives the joints. Returns the axes, in the model's order."""
    spec.option.timestep = TIMESTEP_S
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_EULER:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # stiff servos stay calm in it
    for at, joint in enumerate(spec.joints):
        joint.name = joint.name or f"joint{at}"
    by_name = {joint.name: joint for joint in spec.joints if _turns(joint)}
    driven: dict[str, Any] = {}
    for actuator in list(spec.actuators):
        name = _target(spec, actuator)
        if name in by_name:
            driven.setdefault(name, _gains(actuator, by_name[name]))
            _forget(spec, actuator)
    led = {equality.name1 for equality in spec.equalities if _couples(equality)}
    if not driven:
        driven = {name: _gains(None, joint) for name, joint in by_name.items() if name not in led}
        for body in spec.bodies[1:]:  # as its own controller would: what says nothing of motors is carried
            body.gravcomp = 1.0
    joints = []
    for name, joint in by_name.items():
        if name not in driven:
            continue
        kp, kv, effort = driven[name]
        limited = joint.range[0] < joint.range[1]
        low, high = (float(joint.range[0]), float(joint.range[1])) if limited else (-math.inf, math.inf)
        if spec.compiler.degree and joint.type == mujoco.mjtJoint.mjJNT_HINGE:
            low, high = math.radians(low), math.radians(high)
        joints.append(Joint(name, low, high, joint.type == mujoco.mjtJoint.mjJNT_SLIDE, kp, kv, effort))
        servo = spec.add_actuator(name=_free_name(spec, name), trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
        servo.set_to_position(kp=kp or 1.0, kv=kv)
        if math.isfinite(effort):
            servo.forcelimited, servo.forcerange = True, [-effort, effort]
    return tuple(joints)


def _turns(joint: Any) -> bool:
    return joint.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def _couples(equality: Any) -> bool:
    return bool(equality.type == mujoco.mjtEq.mjEQ_JOINT and equality.name2 and equality.active)


def _target(spec: Any, actuator: Any) -> str:
    """The joint that an actuator drives, empty for another kind. A tendon counts as the first joint
    it runs over."""
    kinds = mujoco.mjtTrn
    if actuator.trntype in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
        return str(actuator.target)
    if actuator.trntype != kinds.mjTRN_TENDON:
        return ""
    tendon = spec.tendon(actuator.target)
    joints = [wrap.target.name for wrap in tendon.path if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT]
    return joints[0] if joints else ""


def _gains(actuator: Any, joint: Any) -> tuple[float, float, float]:
    """kp and kv of the model's own position actuator at a joint, and what it pushes with."""
    effort = math.inf
    if joint.actfrcrange[0] < joint.actfrcrange[1]:
        effort = float(joint.actfrcrange[1])
    if actuator is None:
        return 0.0, 0.0, effort
    at_joint = actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT
    if at_joint and actuator.forcerange[0] < actuator.forcerange[1]:
        effort = min(effort, float(actuator.forcerange[1]))
    is_position = actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE and actuator.biasprm[1] < 0
    if is_position and at_joint and actuator.gear[0] == 1.0:
        return float(actuator.gainprm[0]), -float(actuator.biasprm[2]), effort
    is_motor = actuator.biastype == mujoco.mjtBias.mjBIAS_NONE and actuator.ctrlrange[0] < actuator.ctrlrange[1]
    if is_motor and at_joint:
        effort = min(
            effort, float(actuator.ctrlrange[1]) * abs(float(actuator.gear[0])) * float(actuator.gainprm[0])
        )
    return 0.0, 0.0, effort


def _forget(spec: Any, actuator: Any) -> None:
    """Take an actuator away, with the sensors that listen to it."""
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname == actuator.name:
            spec.delete(sensor)
    spec.delete(actuator)


def _free_name(spec: Any, name: str) -> str:
    taken = {actuator.name for actuator in spec.actuators}
    return name if name not in taken else f"{name}_servo"

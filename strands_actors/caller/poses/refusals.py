"""The texts of the refusals of a motion to a pose: one function for each text."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.contract.shown import shown
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

MOVE_TO = "move_to"

# -- the arguments


def no_pose() -> Refused:
    remedy = "give joint targets, or a pose by xyz, rpy or quat"
    return Refused(Code.EMPTY, "no target is given", remedy, verb=MOVE_TO)


def two_orientations() -> Refused:
    return Refused(Code.BOTH, "rpy and quat are both given", "give one of them", verb=MOVE_TO)


def targets_and_pose() -> Refused:
    remedy = "give joint targets, or a pose by xyz, rpy or quat"
    return Refused(Code.BOTH, "joint targets and a pose are both given", remedy, verb=MOVE_TO)


def seconds_of_pose() -> Refused:
    reason = "seconds is given for a motion to a pose"
    return Refused(Code.BOTH, reason, "leave seconds out, and give speed in m/s", verb=MOVE_TO)


def pose_arguments(name: str) -> Refused:
    reason = f"{name} is given without a pose"
    return Refused(Code.BAD_POSE, reason, "give a pose by xyz, rpy or quat as well", verb=MOVE_TO)


def bad_numbers(name: str, value: object, accepted: str) -> Refused:
    reason, offered = f"{name} is {shown(value)}", shown(value)
    return Refused(Code.BAD_POSE, reason, f"give {accepted}", offered, accepted, verb=MOVE_TO)


def bad_frame(frame: object, frames: Sequence[str]) -> Refused:
    names = " or ".join(frames)
    return Refused(Code.BAD_POSE, f"frame is {shown(frame)}", f"give {names}", shown(frame), names, verb=MOVE_TO)


def bad_box(number: int, box: object) -> Refused:
    reason = f"keep_out {number} is {shown(box)}"
    remedy = 'give {"center": (x, y, z), "size": (x, y, z)} in metres, with sizes above 0'
    return Refused(Code.BAD_POSE, reason, remedy, shown(box), verb=MOVE_TO)


# -- the keys of an action


def unknown_pose_key(key: str, accepted: Sequence[str]) -> Refused:
    names = ", ".join(accepted)
    return Refused(Code.BAD_POSE, f"{key} is no key of the tool's pose", f"give {names}", key, names)


def bad_pose_number(key: str, value: object) -> Refused:
    return Refused(Code.BAD_POSE, f"{key} is {shown(value)}", "give a finite number", shown(value))


def joint_and_pose(joint: str) -> Refused:
    reason = f"{joint} and a pose of the tool are both given"
    return Refused(Code.BOTH, reason, "give the joints of the arm, or the pose")


def part_of_a_pose(keys: Sequence[str]) -> Refused:
    reason = "a part of the tool's pose is missing"
    return Refused(Code.BAD_POSE, reason, f"give all of {', '.join(keys)}", limit=", ".join(keys))


def cannot_follow(xyz: Sequence[float]) -> Refused:
    reason = f"the tool cannot move on to xyz={_triple(xyz, 4)} in this posture of the arm"
    return Refused(Code.OUT_OF_REACH, reason, "go another way, or move the joints")


def would_touch(link: str, other: str) -> Refused:
    return Refused(Code.COLLISION, f"{link} would touch {other}", "go another way, or move the joints")


# -- the robot


def no_arm(verb: str, robot: str) -> Refused:
    reason = f"no model of an arm is known for {robot}, so the pose of its tool cannot be computed"
    return Refused(Code.NO_ARM, reason, "use move_to() with joint targets", verb=verb)


def unknown_joint_position(verb: str, joint: str) -> Refused:
    reason = f"the position of {joint} is not known"
    return Refused(Code.UNKNOWN_POSE, reason, "wait for a reading of all joints", verb=verb)


def moved_meanwhile(joint: str) -> Refused:
    reason = f"{joint} moved while the motion was planned"
    return Refused(Code.MOVED, reason, "wait until the arm stands still, then call it again", verb=MOVE_TO)


# -- the pose


def out_of_reach(xyz: Sequence[float], rpy: Sequence[float], away_m: float) -> Refused:
    nearest = f"xyz={_triple(xyz, 4)}, rpy={_triple(rpy, 2)}"
    reason = f"the position is out of reach by {away_m * 1e3:.1f} mm"
    return Refused(Code.OUT_OF_REACH, reason, f"the nearest pose is {nearest}", limit=nearest, verb=MOVE_TO)


def no_such_orientation(rpy: Sequence[float], turned_deg: float, joints: int) -> Refused:
    nearest = _triple(rpy, 2)
    reason = f"the position can be reached, but the orientation only within {turned_deg:.1f} degrees"
    loose = ", or leave the orientation out" if joints < 6 else ""
    remedy = f"the nearest orientation there is rpy={nearest}. Give it{loose}"
    return Refused(Code.OUT_OF_REACH, reason, remedy, limit=nearest, verb=MOVE_TO)


def leaves_reach(along_m: float) -> Refused:
    reason = f"the pose can be reached, but the arm cannot follow a straight line to it after {along_m:.3f} m"
    return Refused(Code.OUT_OF_REACH, reason, "give linear=False, or go there by way of another pose", verb=MOVE_TO)


def at_singularity(along_m: float) -> Refused:
    reason = f"the straight line passes a singularity after {along_m:.3f} m, where a joint would have to leap"
    return Refused(Code.SINGULAR, reason, "give linear=False, or go there by way of another pose", verb=MOVE_TO)


def too_slow_there(joint: str, seconds: float) -> Refused:
    reason = f"{joint} would need {seconds:.0f} s: the line passes close to a singularity"
    return Refused(Code.SINGULAR, reason, "give linear=False, or go there by way of another pose", verb=MOVE_TO)


def touches_itself(link: str, other: str, share: float | None, linear: bool) -> Refused:
    reason = f"{link} would touch {other}{_where(share, linear)}"
    return Refused(Code.COLLISION, reason, _another(linear), verb=MOVE_TO)


def enters_keep_out(link: str, box: int, share: float | None, linear: bool) -> Refused:
    reason = f"{link} would enter keep_out {box}{_where(share, linear)}"
    return Refused(Code.COLLISION, reason, _another(linear), verb=MOVE_TO)


def inside_keep_out(link: str, box: int) -> Refused:
    reason = f"{link} is in keep_out {box} already"
    return Refused(Code.COLLISION, reason, "move it out with joint targets, or correct keep_out", verb=MOVE_TO)


def _where(share: float | None, linear: bool) -> str:
    if share is None:
        return " at the pose"
    return f" after {share:.3f} m of the line" if linear else f" after {share * 100:.0f} % of the motion"


def _another(linear: bool) -> str:
    return "give another pose, or linear=False" if linear else "give another pose, or go there in two motions"


def _triple(values: Sequence[float], digits: int) -> str:
    return "(" + ", ".join(f"{value:.{digits}f}" for value in values) + ")"

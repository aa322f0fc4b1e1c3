"""The findings of a calibration at a joint, and their texts: the event, the reason and the remedy."""

from __future__ import annotations

import enum

import msgspec

from .axes import COUNTS


class Kind(enum.StrEnum):
    LITTLE = "little"
    """The joint was moved over less than its range."""
    SWAPPED = "swapped"
    """Another joint's servo has moved."""
    TOO_FAST = "too_fast"
    """The joint could not be followed between two readings."""
    RATIO = "ratio"
    """The servo has turned further than the joint can."""
    TURNS = "turns"
    """The servo has turned by more than a turn."""
    FIRMWARE = "firmware"
    """The servo's firmware differs from that of most servos of its model."""
    WRAPS = "wraps"
    """The encoder starts at 0 again within the joint's range. The homing offset allows for it."""
    CANNOT_WRAP = "cannot_wrap"
    """As ``WRAPS``, at a servo with a homing offset that cannot allow for it."""
    SHIFTED = "shifted"
    """Both ends lie elsewhere than at the last calibration."""
    MENDED = "mended"
    """The range in a file went beyond the servo's counts, and was moved into one turn."""
    DIFFERS = "differs"
    """A register of the servo has another value than a file."""


class Finding(msgspec.Struct, frozen=True, omit_defaults=True):
    """One finding at one joint.

    Attributes:
        kind: The kind of the finding.
        joint: The joint.
        counts: Its movement or shift, in encoder counts.
        expected: Its range in the robot's table, in counts.
        other: The joint with the servo that moved in its place.
        teeth: By how many teeth of its horn it has shifted; 0 if by no whole number.
        version: The firmware of its servo.
        usual: The firmware of most servos.
        register: The name of a register.
        file_value: Its value in a file.
        servo_value: Its value in the servo.
    """

    kind: Kind
    joint: str
    counts: int = 0
    expected: int = 0
    other: str = ""
    teeth: int = 0
    version: str = ""
    usual: str = ""
    register: str = ""
    file_value: int = 0
    servo_value: int = 0


def text_of(finding: Finding) -> str:
    """Return the sentences about a finding."""
    joint, moved = finding.joint, _degrees(finding.counts)
    match finding.kind:
        case Kind.LITTLE:
            return (
                f"{joint} was swept over {moved}, and its range is about {_degrees(finding.expected)}. Move it "
                f"until both stops. If it really ends there, or its servo has another gear ratio on purpose, add "
                f"--accept {joint}"
            )
        case Kind.SWAPPED:
            return (
                f"{joint} was to move, and the servo of {finding.other} moved by {moved} in its place. If you "
                f"moved {joint}, the two joints are swapped: give their servos their ids again (setup-motors "
                f"--joint {joint} --joint {finding.other}), or exchange the servos"
            )
        case Kind.TOO_FAST:
            return f"{joint} was moved too fast to be followed. Move it slower"
        case Kind.RATIO:
            return (
                f"{joint} was swept over {moved}, and its range is about {_degrees(finding.expected)}. Its servo "
                f"seems to have another gear ratio, or a stop is missing. Mount the servo that the robot's list of "
                f"parts names. If the joint really turns so far, add --accept {joint}"
            )
        case Kind.TURNS:
            return (
                f"the servo of {joint} turned by {moved}, more than a turn, and its range is about "
                f"{_degrees(finding.expected)}. Its servo has another gear ratio, or its horn slips. Tighten the "
                "horn's screw, and compare the servo with the robot's list of parts"
            )
        case Kind.FIRMWARE:
            return (
                f"the servo of {joint} has firmware {finding.version}, and most of its kind have {finding.usual}. "
                "LeRobot does not connect to such an arm. Update the firmware with the maker's software (Feetech: "
                "https://www.feetechrc.com/software), or add --accept firmware"
            )
        case Kind.WRAPS:
            return f"the encoder of {joint} starts at 0 again within its range. The new offset allows for it"
        case Kind.CANNOT_WRAP:
            return (
                f"the encoder of {joint} starts at 0 again within its range. This servo counts anew there each "
                "time it is switched on, and no offset can change that. Take off its horn, turn the servo by half "
                "a turn, mount the horn again, and calibrate again"
            )
        case Kind.SHIFTED:
            return _shifted(finding)
        case Kind.MENDED:
            return (
                f"the range of {joint} in the file goes beyond the servo's counts. It was moved into one turn, and "
                "is the same range of the joint"
            )
        case Kind.DIFFERS:
            return (
                f"{joint}: {finding.register} is {finding.file_value} in the file, and {finding.servo_value} in "
                "its servo. If the servo is a new one, do not write this: calibrate the arm"
            )


def _shifted(finding: Finding) -> str:
    joint, angle = finding.joint, _degrees(abs(finding.counts))
    teeth = abs(finding.teeth)
    where = f"{angle} from where they were at the last calibration"
    if not teeth:
        reason = "The servo or its horn was mounted otherwise"
    else:
        reason = f"Its horn sits {teeth} {'tooth' if teeth == 1 else 'teeth'} further"
    return (
        f"both ends of {joint} lie {where}. {reason}. The new calibration allows for it. If you did not take it "
        "off, tighten its screw"
    )


def _degrees(counts: int) -> str:
    return f"{counts * 360 / COUNTS:.1f} degrees"

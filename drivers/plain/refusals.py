"""Refusals that only robots with a user's driver class have: the codes, and one function for each text."""

from __future__ import annotations

from strands_actors.drivers.common.kit.refusals import MotorCode
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code, RefusalCode


class PlainCode(RefusalCode):
    """See ``docs/refusals.md``."""

    REFUSED_BY_DRIVER = "refused_by_driver", "the robot's own driver refused a command", "resume()"


def stale_axis(key: str, age_ms: float, limit_ms: float) -> Refused:
    age = f"for {age_ms:.0f} ms"
    remedy = "check the robot's cable and power. The axis can be moved again as soon as the robot answers"
    return Refused(Code.STALE, f"{key} has not been read {age}", remedy, age, f"{limit_ms:.0f} ms")


def rejected_by_class(axis: str, cause: str) -> Refused:
    return Refused(PlainCode.REFUSED_BY_DRIVER, f"{axis}: {cause}", "remove the cause, then call resume()", cause)


def no_torque(axis: str, fault: str) -> Refused:
    remedy = "take the load off, then call stop() and resume() to energise it again"
    return Refused(MotorCode.LIMP, f"{axis} has lost its torque", remedy, fault, "torque")

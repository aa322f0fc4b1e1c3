"""The refusals of a robot that is made of parts: one function for each text."""

from __future__ import annotations

import msgspec

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code


def of_part(part: str, refusal: Refused) -> Refused:
    """Return the refusal of a part's own check, with the name of the part."""
    return msgspec.structs.replace(refusal, reason=f"{part}: {refusal.reason}")


def part_stopped(part: str, cause: str) -> Refused:
    """Return the refusal after one part has stopped without an order of the robot. The other parts are stopped."""
    why = f": {cause}" if cause else ""
    return Refused(Code.FAULTED, f"{part} has stopped{why}", "clear its fault, then call resume()", part)


def part_held(part: str, cause: str) -> Refused:
    """Return the refusal after one part has held without an order of the robot, so that all parts hold."""
    why = f": {cause}" if cause else ""
    return Refused(Code.HOLDING, f"{part} holds{why}", "send the command again", part)

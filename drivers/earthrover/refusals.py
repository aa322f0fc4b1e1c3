"""Refusals of the EarthRover driver: the codes, and one function for each text."""

from __future__ import annotations

from strands_actors.contract.refusals import bad_argument
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import RefusalCode


class EarthRoverCode(RefusalCode):
    """See ``docs/refusals.md``."""

    SERVICE = "service", "the SDK process answers with an error", "look at the SDK process"


def unfit_text(text: object, longest: int) -> Refused:
    return bad_argument("text", text, f"1..{longest} characters")


def service_failed(http_status: int) -> Refused:
    return Refused(EarthRoverCode.SERVICE, f"the SDK process answered with HTTP status {http_status}")

"""The refusal codes for the faults of a Feetech servo."""

from __future__ import annotations

from collections.abc import Mapping

from strands_actors.drivers.common.kit.refusals import MotorCode

FAULT_CODES: Mapping[str, MotorCode] = {
    "limp": MotorCode.LIMP,
    "overload": MotorCode.LIMP,
    "voltage": MotorCode.VOLTAGE,
    "overheat": MotorCode.TEMPERATURE,
}

"""What the faults of a Feetech servo mean to who is refused because of one."""

from __future__ import annotations

FAULT_CODES = {"limp": "limp", "overload": "limp", "voltage": "voltage", "overheat": "temperature"}
REMEDIES = {"limp": "take the load off, then stop and resume to energise it again"}

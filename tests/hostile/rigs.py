"""The table of rigs: for each wire its robot in memory, the messages of a hostile peer, and a target.

The hostile-peer suite runs every row of ``RIGS``. A new wire adds a row to the file of its kind.
"""

from __future__ import annotations

from collections.abc import Mapping

from . import (
    rigs_can,
    rigs_dds,
    rigs_franka,
    rigs_grpc,
    rigs_json,
    rigs_kuka,
    rigs_radio,
    rigs_serial,
    rigs_tcp,
    rigs_ur,
    rigs_web,
)
from .bench import Rig

RIGS: Mapping[str, Rig] = {
    **rigs_tcp.RIGS,
    **rigs_grpc.RIGS,
    **rigs_serial.RIGS,
    **rigs_can.RIGS,
    **rigs_radio.RIGS,
    **rigs_web.RIGS,
    **rigs_json.RIGS,
    **rigs_dds.RIGS,
    **rigs_kuka.RIGS,
    **rigs_franka.RIGS,
    **rigs_ur.RIGS,
}

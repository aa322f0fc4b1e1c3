"""Keep the tool out of protection zones.

Only the point of the tool counts. The limits of speed in a zone and in its envelope are not modelled: no motion
enters an enabled zone, as with a limit of zero [assumed].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova.protocol import SubError

from . import messages as m
from .errors import CallFailed
from .kinematics import Matrix

CYLINDER, SPHERE, PRISM = 1, 2, 3
DIMENSIONS = {CYLINDER: 2, SPHERE: 1, PRISM: 3}


class Zone(NamedTuple):
    """One zone. ``rest`` has the encoded fields that the base only stores."""

    enabled: bool
    shape: int
    origin: Matrix
    rotation: Matrix
    dimensions: Matrix
    rest: bytes

    def contains(self, point: Matrix) -> bool:
        """Return True if the point in metres is in the zone."""
        x, y, z = self.rotation.T @ (point - self.origin)
        match self.shape:
            case 1:
                radius, height = self.dimensions
                return bool(np.hypot(x, y) < radius and abs(z) < height / 2.0)
            case 2:
                return bool(np.linalg.norm((x, y, z)) < self.dimensions[0])
        return bool((np.abs((x, y, z)) < self.dimensions / 2.0).all())


def decode_zone(payload: bytes) -> Zone:
    """Decode a ``ProtectionZone``. Raise ``CallFailed`` for a shape that is none."""
    fields = pb.message(payload)
    shape = m.sub_message(fields, 5)
    origin = m.sub_message(shape, 2)
    rows = m.sub_message(shape, 3)
    rotation = np.array([[m.finite(m.sub_message(rows, row), column) for column in (1, 2, 3)] for row in (1, 2, 3)])
    kind, dimensions = pb.last_int(shape, 1), np.array(m.repeated_floats(shape, 4))
    if len(dimensions) != DIMENSIONS.get(kind, -1) or not (dimensions > 0.0).all():
        raise CallFailed(SubError.INVALID_PARAM, f"shape {kind} with the dimensions {dimensions.tolist()}")
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
        raise CallFailed(SubError.INVALID_PARAM, "the orientation is no rotation")
    kept = [(number, value) for number in (2, 3, 5, 6, 7) for value in fields.get(number, ())]
    return Zone(
        bool(pb.last_int(fields, 4)),
        kind,
        np.array([m.finite(origin, number) for number in (1, 2, 3)]),
        rotation,
        dimensions,
        b"".join(pb.bytes_field(number, value) for number, value in kept if isinstance(value, bytes)),
    )


def encode_zone(identifier: int, zone: Zone) -> bytes:
    return pb.bytes_field(1, m.Handle(identifier).encode()) + pb.varint_field(4, zone.enabled) + zone.rest

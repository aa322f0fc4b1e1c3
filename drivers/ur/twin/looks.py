"""The looks of a UR arm, from the dimensions and the radius in its table.

See ``drivers/common/simulation_control/looks``.
"""

from __future__ import annotations

from collections.abc import Sequence

TUBE, CAP, FOOT, FLANGE = "silver", "sky", "graphite", "steel"

Station = tuple[tuple[float, float, float], float]
"""A point in the frame of a body, and the radius there."""


def looks_of(dh_m: Sequence[float], radius_m: float) -> str:
    """Return the table of looks of an arm.

    A UR arm has two tubes side by side: that of the upper arm lies one joint's length beside that of the forearm.
    Each joint has a round housing, and a blue cap at the side that ends.

    Args:
        dh_m: d1, a2, a3, d4, d5, d6 in metres.
        radius_m: Radius of the joint between base and shoulder in metres.
    """
    d1, a2, a3, d4, d5, d6 = dh_m
    joint, elbow, wrist = 1.08 * radius_m, 0.86 * radius_m, 0.72 * radius_m
    upper, lower = 1.02 * d4, 0.05 * d4  # where the tubes lie along the axes of shoulder and elbow
    rows = [
        _can("base", FOOT, ((0, 0, 0), 1.26 * joint), ((0, 0, 0.012), 1.24 * joint)),
        _can(
            "base", TUBE, ((0, 0, 0.008), 1.2 * joint), ((0, 0, 0.22 * d1), 1.07 * joint), ((0, 0, 0.6 * d1), joint)
        ),
        f"shoulder {TUBE} rod 0,0,{-0.4 * d1:.4f}:{joint:.4f} 0,0,0:{joint:.4f} r{joint / 2:.4f}",
        _can("shoulder", TUBE, ((0, 0.96 * joint, 0), joint), ((0, 1.04 * joint - upper, 0), joint)),
        _can("shoulder", CAP, ((0, 0.93 * joint, 0), 0.91 * joint), ((0, 1.15 * joint, 0), 0.8 * joint)),
        _can("upper_arm", TUBE, ((0, 0, upper - 1.02 * joint), joint), ((0, 0, upper + 1.02 * joint), joint)),
        _can("upper_arm", CAP, ((0, 0, upper + joint), 0.91 * joint), ((0, 0, upper + 1.2 * joint), 0.8 * joint)),
        _tube("upper_arm", a2, upper, 0.92 * radius_m, 0.8 * radius_m, elbow),
        _can("upper_arm", TUBE, ((a2, 0, upper - 1.16 * elbow), elbow), ((a2, 0, upper + 1.1 * elbow), elbow)),
        _can(
            "upper_arm", CAP, ((a2, 0, upper + elbow), 0.93 * elbow), ((a2, 0, upper + 1.3 * elbow), 0.81 * elbow)
        ),
        _can("forearm", TUBE, ((0, 0, lower - 1.07 * elbow), elbow), ((0, 0, upper - 1.2 * elbow), elbow)),
        _can("forearm", CAP, ((0, 0, lower - elbow), 0.93 * elbow), ((0, 0, lower - 1.28 * elbow), 0.81 * elbow)),
        _tube("forearm", a3, lower, 0.78 * radius_m, 0.6 * radius_m, 0.66 * radius_m),
        _can("forearm", TUBE, ((a3, 0, lower - 1.03 * wrist), wrist), ((a3, 0, d4 - 1.03 * wrist), wrist)),
        _can(
            "forearm",
            CAP,
            ((a3, 0, lower - 0.97 * wrist), 0.92 * wrist),
            ((a3, 0, lower - 1.28 * wrist), 0.8 * wrist),
        ),
        _can("wrist_1", TUBE, ((0, 0, -wrist), wrist), ((0, 0, 0.98 * wrist), wrist)),
        _can("wrist_1", CAP, ((0, 0, 0.92 * wrist), 0.92 * wrist), ((0, 0, 1.22 * wrist), 0.8 * wrist)),
        _can("wrist_1", TUBE, ((0, 0, 0), 0.96 * wrist), ((0, wrist - d5, 0), wrist)),
        _can("wrist_2", TUBE, ((0, 0, -wrist), wrist), ((0, 0, 0.98 * wrist), wrist)),
        _can("wrist_2", CAP, ((0, 0, 0.92 * wrist), 0.92 * wrist), ((0, 0, 1.22 * wrist), 0.8 * wrist)),
        _can("wrist_2", TUBE, ((0, 0, 0), 0.96 * wrist), ((0, 0.5 * d6, 0), wrist)),
        _can("wrist_3", FLANGE, ((0, 0, -0.48 * d6), 0.97 * wrist), ((0, 0, -0.06 * d6), 0.94 * wrist)),
        _can("wrist_3", FOOT, ((0, 0, -0.1 * d6), 0.7 * wrist), ((0, 0, 0), 0.7 * wrist)),
    ]
    return "\n".join(rows)


def _can(body: str, material: str, *stations: Station) -> str:
    places = (f"{x:.4f},{y:.4f},{z:.4f}:{radius:.4f}" for (x, y, z), radius in stations)
    return f"{body} {material} can {' '.join(places)}"


def _tube(body: str, length: float, z: float, first: float, middle: float, last: float) -> str:
    """Return the tube of a link along x, which is wider at its ends."""
    parts = ((0.0, first), (0.12, middle), (0.88, middle), (1.0, last))
    return _can(body, TUBE, *(((length * part, 0, z), radius) for part, radius in parts))

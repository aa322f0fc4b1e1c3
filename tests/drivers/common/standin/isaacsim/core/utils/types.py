from typing import Any, NamedTuple


class ArticulationAction(NamedTuple):
    joint_positions: Any = None
    joint_velocities: Any = None
    joint_efforts: Any = None
    joint_indices: Any = None

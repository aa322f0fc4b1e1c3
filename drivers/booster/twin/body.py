"""Build the MuJoCo body of the simulated T1 from its table in ``robots.toml``."""

from __future__ import annotations

from strands_actors.drivers.booster.robots import TABLES, Model
from strands_actors.drivers.common.kinematics.link_rows import with_limits
from strands_actors.drivers.common.physics.legged_body import LeggedBody


def body_of(model: Model) -> LeggedBody:
    """Return the simulated body of a robot type. Joint limits, torques and speeds come from
    ``model.motors``, all else from its table in ``robots.toml``."""
    table = TABLES.table(model.name)
    motors = {motor.key: motor for motor in model.motors}

    def limits_of(key: str) -> str:
        motor = motors[key]
        return f"{motor.low},{motor.high} {motor.torque} {motor.speed}"

    rows = with_limits(table["links"], limits_of)
    return LeggedBody({**table, "model_rows": rows}, [motor.key for motor in model.motors])

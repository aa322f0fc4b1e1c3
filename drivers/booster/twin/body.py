"""Build the MuJoCo body of the simulated T1 from its table in ``robots.toml``."""

from __future__ import annotations

from strands_actors.drivers.booster.robots import TABLES, Model
from strands_actors.drivers.common.physics.legged_body import LeggedBody
from strands_actors.drivers.common.physics.model_rows import with_limits


def body_of(model: Model) -> LeggedBody:
    """Return the body. Joint limits and torques come from the motors in the table, all else from
    ``links``."""
    table = TABLES.table(model.name)
    motors = {motor.key: motor for motor in model.motors}

    def limits_of(key: str) -> str:
        motor = motors[key]
        return f"{motor.low},{motor.high} {motor.torque} {motor.speed}"

    rows = with_limits(table["links"], limits_of)
    return LeggedBody({**table, "model_rows": rows}, [motor.key for motor in model.motors])

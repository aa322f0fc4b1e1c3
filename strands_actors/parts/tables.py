"""Load ``robots.toml``: the robots of this package that are made of other robots."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from typing import Any

TABLES: Mapping[str, Mapping[str, Any]] = tomllib.loads(
    resources.files("strands_actors.parts").joinpath("robots.toml").read_text("utf-8")
)
"""Each robot of parts by its name."""
CAMERA_JOINED_BY = "_"
"""What stands between the names of a part and of its camera, as in LeRobot."""
JOINED_BY = "."
"""What stands between the names of a part and of its axis, if a robot's table does not say otherwise."""

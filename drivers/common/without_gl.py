"""MuJoCo, imported without OpenGL: physics needs none, and a word in ``MUJOCO_GL`` that MuJoCo does not know would
otherwise keep a robot from moving. Whoever renders picks a platform when it does (see ``common.door.studio``)."""

from __future__ import annotations

import os
from typing import Any

_wanted = os.environ.get("MUJOCO_GL")
os.environ["MUJOCO_GL"] = "disable"
try:
    import mujoco as _mujoco
finally:
    if _wanted is None:
        del os.environ["MUJOCO_GL"]
    else:
        os.environ["MUJOCO_GL"] = _wanted

mujoco: Any = _mujoco

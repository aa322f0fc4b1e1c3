"""Import MuJoCo for its physics only.

It is imported without OpenGL, which physics does not need. Otherwise an unknown value of ``MUJOCO_GL`` would
prevent the start of a robot. The renderer chooses a platform later (see ``common.simulation_control.renderer``).

MuJoCo's time measurement is switched off. The bindings measure every part of every step (``mjData.timer``), and
this project does not use the result. The measurement took a sixth of the time of an arm's step (4.3 us with it,
3.55 without).
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import Any

_mujoco_gl = os.environ.get("MUJOCO_GL")
os.environ["MUJOCO_GL"] = "disable"
try:
    import mujoco as _mujoco
finally:
    if _mujoco_gl is None:
        del os.environ["MUJOCO_GL"]
    else:
        os.environ["MUJOCO_GL"] = _mujoco_gl

mujoco: Any = _mujoco

PLAIN: Any = mujoco.MjSpec()
"""Its ``default`` is MuJoCo's own. Elements that are added to a user's model get it. Otherwise the main
default of that model (a gear, a control range, no contacts) would apply to them."""

for _library in Path(_mujoco.__file__).parent.glob("libmujoco*"):
    # ``mjcb_time`` is a documented global of MuJoCo's C interface. ``mujoco.set_mjcb_time`` cannot set it to null.
    ctypes.c_void_p.in_dll(ctypes.CDLL(str(_library)), "mjcb_time").value = None

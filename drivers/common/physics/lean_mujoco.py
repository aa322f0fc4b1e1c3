"""MuJoCo, imported for its physics only.

It is imported without OpenGL, which physics does not need. A value of ``MUJOCO_GL`` that MuJoCo does not
know would otherwise keep a robot from moving. The renderer chooses a platform later (see
``common.control.renderer``).

It runs without its stopwatch. The bindings time every part of every step for figures (``mjData.timer``)
that are not read here. Reading the clock took a sixth of an arm's step (measured: 4.3 us with it, 3.55
without).
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
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

PLAIN: Any = mujoco.MjSpec()
"""Its ``default`` is MuJoCo's own. Elements that are added to a user's model get it. Otherwise the main
default of that model (a gear, a control range, no contacts) would apply to them."""

for _library in Path(_mujoco.__file__).parent.glob("libmujoco*"):
    # This is a documented global of MuJoCo's C interface. ``mujoco.set_mjcb_time`` cannot set it to null.
    ctypes.c_void_p.in_dll(ctypes.CDLL(str(_library)), "mjcb_time").value = None

"""MuJoCo, imported for its physics alone.

Without OpenGL: physics needs none, and a word in ``MUJOCO_GL`` that MuJoCo does not know would
otherwise keep a robot from moving. Whoever renders picks a platform when it does (see
``common.control.renderer``).

Without its stopwatch: the bindings time every part of every step, for figures (``mjData.timer``)
that nobody here reads. A sixth of an arm's step was reading the clock (measured: 4.3 us with it,
3.55 without).
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
"""Its ``default`` is MuJoCo's own. Elements that are added to a user's model get it: otherwise the
main default of that model (a gear, a control range, no contacts) would apply to them."""

for _library in Path(_mujoco.__file__).parent.glob("libmujoco*"):
    # a global of MuJoCo's C interface, documented there; ``mujoco.set_mjcb_time`` sets no null
    ctypes.c_void_p.in_dll(ctypes.CDLL(str(_library)), "mjcb_time").value = None

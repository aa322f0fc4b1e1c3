"""LeRobot's own teleoperators, by the name of their type. It is imported in the process of the
teleoperation, and nowhere else: it brings gigabytes.

Two things of them are made otherwise. Nobody is there to press a key, so one that is not calibrated
is refused, instead of asking. And LeRobot counts the joints of some leaders (koch, omx) in shares
of their calibrated range, without a choice; here they are degrees, as those of all others are.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import pkgutil
from typing import Any

PREFIX = "lerobot:"
FACTORY = "strands_actors.teleoperation.lerobot:make"
TELEOPERATORS = "lerobot.teleoperators"


def is_there() -> bool:
    """Whether lerobot is installed; it is not imported for that."""
    return importlib.util.find_spec("lerobot") is not None


def make(type: str, **options: Any) -> Any:
    """Return a teleoperator of lerobot's, or of a package that its discovery finds. ``options``:
    the fields of its config, mappings where that has configs of its own. Raise ``ValueError`` for a
    type that there is not, and for a field."""
    config_class = importlib.import_module(f"{TELEOPERATORS}.config").TeleoperatorConfig
    utils = importlib.import_module(f"{TELEOPERATORS}.utils")
    register = getattr(importlib.import_module("lerobot.utils.import_utils"), "register_third_party_plugins", None)
    if register is not None:
        register()
    known = config_class.get_known_choices()
    for module in pkgutil.iter_modules(importlib.import_module(TELEOPERATORS).__path__):
        if type in known:
            break
        if module.ispkg:
            _import_if_it_can(f"{TELEOPERATORS}.{module.name}")
            known = config_class.get_known_choices()
    if type not in known:
        raise ValueError(f"lerobot has no teleoperator {type!r}. it has {', '.join(sorted(known))}")
    own = list(inspect.signature(known[type]).parameters)
    if unknown := [name for name in options if name not in own]:
        raise ValueError(f"lerobot's {type} has no {', '.join(unknown)}. it has {', '.join(own)}")
    import draccus  # lerobot's own; what it reads its command line with

    made = utils.make_teleoperator_from_config(draccus.decode(known[type], options))
    if "use_degrees" not in own:
        _in_degrees(made)
    return Unattended(made, type, options.get("id"))


class Unattended:
    """One of lerobot's, where nobody can answer a question of its."""

    def __init__(self, made: Any, type: str, id: str | None) -> None:
        self._made = made
        self._type = type
        self._id = id

    def connect(self) -> None:
        """Raise ``ConnectionError`` for one that is not calibrated."""
        connect = self._made.connect
        connect(**({"calibrate": False} if "calibrate" in inspect.signature(connect).parameters else {}))
        if self._made.is_calibrated is not False:  # None of some that need no calibration
            return
        self._made.disconnect()
        raise ConnectionError(
            f"lerobot's {self._type} {self._id!r} is not calibrated as its motors are. run lerobot-calibrate "
            f"--teleop.type={self._type} --teleop.id={self._id}"
        )

    def get_action(self) -> Any:
        return self._made.get_action()

    def disconnect(self) -> None:
        if self._made.is_connected:
            self._made.disconnect()


def _in_degrees(made: Any) -> None:
    """Have the joints of a servo bus told in degrees."""
    for motor in getattr(getattr(made, "bus", None), "motors", {}).values():
        modes = type(motor.norm_mode)
        if motor.norm_mode is modes.RANGE_M100_100:
            motor.norm_mode = modes.DEGREES


def _import_if_it_can(module: str) -> None:
    """Some need a package that is not there: they are not among the types then."""
    try:
        importlib.import_module(module)
    except ImportError:
        return

"""LeRobot's teleoperators, by the name of their type.

Only the process of the teleoperation imports LeRobot, since it takes gigabytes.

Two things differ from LeRobot. A teleoperator that is not calibrated is refused, since no user could answer
LeRobot's question in this process. And the joints of some leaders (koch, omx) are in degrees here, as those of all
other leaders. LeRobot reports them only as shares of their calibrated range.
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


def is_installed() -> bool:
    """Return True if LeRobot is installed, without importing it."""
    return importlib.util.find_spec("lerobot") is not None


def make(type: str, **options: Any) -> Any:
    """Return a teleoperator of LeRobot, or of a package that LeRobot's discovery finds.

    Args:
        type: Name of the teleoperator's type.
        options: Fields of the teleoperator's config. A nested config is a mapping.

    Raises:
        ValueError: The type or a field is unknown.
    """
    config_class = importlib.import_module(f"{TELEOPERATORS}.config").TeleoperatorConfig
    utils = importlib.import_module(f"{TELEOPERATORS}.utils")
    register = getattr(importlib.import_module("lerobot.utils.import_utils"), "register_third_party_plugins", None)
    if register is not None:
        register()
    types = config_class.get_known_choices()
    for module in pkgutil.iter_modules(importlib.import_module(TELEOPERATORS).__path__):
        if type in types:
            break
        if module.ispkg:
            _import_if_it_can(f"{TELEOPERATORS}.{module.name}")
            types = config_class.get_known_choices()
    if type not in types:
        raise ValueError(f"lerobot has no teleoperator {type!r}. Use one of {', '.join(sorted(types))}")
    own = list(inspect.signature(types[type]).parameters)
    if unknown := [name for name in options if name not in own]:
        raise ValueError(f"lerobot's {type} has no option {', '.join(unknown)}. Use {', '.join(own)}")
    import draccus  # installed with LeRobot, which also reads its command line with it

    made = utils.make_teleoperator_from_config(draccus.decode(types[type], options))
    if "use_degrees" not in own:
        _in_degrees(made)
    return Unattended(made, type, options.get("id"))


class Unattended:
    """A teleoperator of LeRobot in a process without a user. Where LeRobot would ask the user a question, it
    raises.
    """

    def __init__(self, made: Any, type: str, id: str | None) -> None:
        self._made = made
        self._type = type
        self._id = id

    def connect(self) -> None:
        """Connect. Raise ``ConnectionError`` if the teleoperator is not calibrated."""
        connect = self._made.connect
        connect(**({"calibrate": False} if "calibrate" in inspect.signature(connect).parameters else {}))
        if self._made.is_calibrated is not False:  # None for some that need no calibration
            return
        self._made.disconnect()
        raise ConnectionError(
            f"lerobot's {self._type} {self._id!r} is not calibrated as its motors are. Run lerobot-calibrate "
            f"--teleop.type={self._type} --teleop.id={self._id}"
        )

    def get_action(self) -> Any:
        return self._made.get_action()

    def disconnect(self) -> None:
        if self._made.is_connected:
            self._made.disconnect()


def _in_degrees(made: Any) -> None:
    """Make a servo bus of LeRobot report its joints in degrees instead of shares of the calibrated range."""
    for motor in getattr(getattr(made, "bus", None), "motors", {}).values():
        modes = type(motor.norm_mode)
        if motor.norm_mode is modes.RANGE_M100_100:
            motor.norm_mode = modes.DEGREES


def _import_if_it_can(module: str) -> None:
    """Import a module. If a package that the module needs is missing, ignore this; the module's types are then
    unknown.
    """
    try:
        importlib.import_module(module)
    except ImportError:
        return

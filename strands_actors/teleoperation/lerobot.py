"""LeRobot's own teleoperators, by the name of their type. It is imported in the process of the
teleoperation, and nowhere else: it brings gigabytes."""

from __future__ import annotations

import importlib
import importlib.util
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
    the fields of its config. Raise ``ValueError`` for a type that there is not."""
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
    return utils.make_teleoperator_from_config(known[type](**options))


def _import_if_it_can(module: str) -> None:
    """Some need a package that is not there: they are not among the types then."""
    try:
        importlib.import_module(module)
    except ImportError:
        return

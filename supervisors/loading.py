"""A driver travels between processes as plain data, and is built anew in each."""

from __future__ import annotations

import importlib
from typing import Any

from strands_actors.runtime.contract import Driver


def describe_driver(driver_class: type[Driver], robot: str, port: str, options: dict[str, Any]) -> dict[str, Any]:
    return {"class": place_of(driver_class), "robot": robot, "port": port, "options": options}


def place_of(thing: type[Any]) -> str:
    """Where ``load`` finds it."""
    return f"{thing.__module__}:{thing.__qualname__}"


def load(where: str) -> Any:
    """The object at ``module:qualified.name``."""
    module, _, name = where.partition(":")
    found: Any = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    return found


def load_driver(description: dict[str, Any]) -> Driver:
    """For a process that is going to use it: with what it needs imported."""
    driver_class = load(description["class"])
    driver: Driver = driver_class(description["robot"], description["port"], description["options"])
    driver.preload()
    return driver

"""The functions, methods, keywords, extras and commands that a message recommends exist."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import re
import tomllib
from collections.abc import Callable, Iterator

import pytest
import typer.main

from strands_actors import MeshConfig, Robot
from strands_actors.caller.handle.robot import AsyncRobot, RealRobot, SimRobot
from strands_actors.contract.loading import load
from strands_actors.drivers import (
    DRIVER_CHOICES,
    ROS2,
    constructor_keywords,
    get_native_driver_class,
    list_native_drivers,
    register_native_driver,
    register_robot,
)
from strands_actors.policies.registry import list_providers
from strands_actors.surfaces.cli import app
from strands_actors.testing import check_driver

from .test_imports import MODULES, ROOT
from .test_public import PUBLIC

CALL = re.compile(r"(?<![\w.'])([A-Za-z_][\w.]*)\((?=\)|\.\.\.|['\"]|\w+=|$)")
KEYWORD = re.compile(r"(?<![\w.\[/?&-])([a-z_]\w+)=(?=\.\.\.|['\"]|[ ,.)]|True|False|None|$)")
DRIVER = re.compile(r"driver='(\w+)'")
EXTRA = re.compile(r"strands-actors\[(\w+)\]")
COMMAND = re.compile(r"`strands-actors (\w+)")

NOT_KEYWORDS = {"boundary"}
"""Methods of HTTP."""

NOT_TOLD = {"serve_threads"}
"""Internal functions that a message of an internal error names. Users cannot call them."""


def messages(source: str) -> Iterator[str]:
    """Yield the texts of a module that a user may read, without docstrings, code and XML."""
    tree = ast.parse(source)
    silent = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in silent:
            text = node.value
            if " " in text and "import " not in text and "<" not in text and '="' not in text:
                yield text


@functools.cache
def all_messages() -> list[tuple[str, str]]:
    return [(name, text) for name, path in MODULES.items() for text in messages(path.read_text())]


def callables() -> set[str]:
    """Return the names that a user may call: public names, methods of handles, services of drivers."""
    found = {"Robot"}
    for name in PUBLIC:
        found |= set(importlib.import_module(name).__all__)
    for handle in (RealRobot, SimRobot, AsyncRobot):
        found |= {name for name in dir(handle) if not name.startswith("_")}
    for robot in list_native_drivers():
        driver_class = get_native_driver_class(robot)
        levels = (load(where) for where in getattr(driver_class, "LEVELS", {}).values())
        for each in (driver_class, *levels):
            found |= set(getattr(each, "SERVICES", {}))
    return found | {f"strands_actors.{name}" for name in found}


def keywords() -> set[str]:
    taken: list[Callable[..., object]] = [Robot, check_driver, register_robot, register_native_driver, MeshConfig]
    taken += [RealRobot.run_policy, RealRobot.start_task, RealRobot.move_to, SimRobot.add_object]
    found = {keyword for each in taken for keyword in inspect.signature(each).parameters}
    for provider in list_providers().values():
        module, _, name = provider.where.partition(":")
        found |= set(inspect.signature(getattr(importlib.import_module(module), name)).parameters)
    found |= set(constructor_keywords(load(ROS2)))
    for robot in list_native_drivers():
        driver_class = get_native_driver_class(robot)
        assert driver_class is not None
        found |= set(constructor_keywords(driver_class))
        for service in getattr(driver_class, "SERVICES", {}).values():
            found |= set(service.arguments)
        found |= {name for verb in getattr(driver_class, "TOOL_VERBS", ()) for name in verb.inputs}
    return found


def unknown(texts: list[tuple[str, str]], pattern: re.Pattern[str], known: set[str]) -> list[str]:
    return [f"{where}: {text!r}" for where, text in texts for name in pattern.findall(text) if name not in known]


def test_no_message_names_a_function_that_does_not_exist() -> None:
    assert unknown(all_messages(), CALL, callables() | NOT_TOLD) == []


def test_no_message_names_a_keyword_that_nothing_takes() -> None:
    assert unknown(all_messages(), KEYWORD, keywords() | NOT_KEYWORDS) == []


def test_no_message_recommends_a_driver_that_drives_nothing() -> None:
    assert unknown(all_messages(), DRIVER, set(DRIVER_CHOICES)) == []


def test_every_extra_and_command_that_a_message_names_is_there() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert unknown(all_messages(), EXTRA, set(extras)) == []
    commands = set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    assert unknown(all_messages(), COMMAND, commands) == []


@pytest.mark.parametrize(
    ("source", "pattern", "known"),
    [
        ("raise ValueError(f'{name} leads. Use Teleoperator({name!r})')", CALL, {"Robot"}),
        ("raise ValueError('no camera here. Use open_camera() first')", CALL, {"Robot"}),
        ("raise ValueError('none there: give prot=, its address')", KEYWORD, {"port"}),
        ("raise ValueError(\"no cameras. Use driver='lerobot'\")", DRIVER, {"strands"}),
    ],
)
def test_a_missing_name_in_a_message_is_found(source: str, pattern: re.Pattern[str], known: set[str]) -> None:
    assert len(unknown([("here", text) for text in messages(source)], pattern, known)) == 1

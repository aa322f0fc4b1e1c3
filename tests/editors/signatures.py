"""Make ``strands_actors/caller/handle/robot.pyi``: the signatures of ``Robot`` and ``open_robot`` by robot
and mode, for editors and type checkers.

``python -m tests.editors.signatures`` writes the file. Names of robots, keywords, their types and
services come from the declarations of the drivers. The keywords of every robot come from ``Robot`` itself.
"""

from __future__ import annotations

import inspect
import math
import textwrap
import types
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec

from strands_actors.caller.handle import factory
from strands_actors.caller.handle.async_robot import AsyncRobot
from strands_actors.caller.handle.real_robot import RealRobot
from strands_actors.caller.handle.sim_robot import SimRobot
from strands_actors.caller.resolve.attached import OWN
from strands_actors.caller.resolve.simulated import BACKENDS
from strands_actors.contract.driver import Driver, Service
from strands_actors.contract.loading import load
from strands_actors.contract.options import Meanings
from strands_actors.contract.short_names import SHORT_NAMES
from strands_actors.contract.surface import driver_name
from strands_actors.contract.tool_verbs import ToolVerb
from strands_actors.drivers import WIRES
from strands_actors.drivers.plain.lerobot.types import TYPES
from strands_actors.kernel.messages import sentence_case
from strands_actors.supervisors.loading import build_driver

FILE = Path(factory.__file__).with_name("robot.pyi")
WIDTH = 116

OF_HARDWARE = ("port", "transport", "sim", "require_drill", "at")
OF_SIMULATIONS = ("backend", "urdf_path", "position", "orientation", "keyframe", "gated", "onboard")
"""Keywords that only one of ``Robot`` and ``open_robot`` takes. All others belong to both."""
GIVEN_BY_HOST = {name for name in inspect.signature(factory.Robot).parameters if name not in OWN}
"""Keywords that a handle of a host's robot does not take."""
NONE: Mapping[str, ToolVerb] = {}
WITH_ACTION = ("step",)
"""Services that take a command, which they write first."""

HEAD = '''\
# fmt: off
"""Signatures of the factories by robot and mode, for editors and type checkers.

Made by ``python -m tests.editors.signatures`` from the drivers' options and services: do not edit.
A robot whose name is not literal has the last of the overloads that fit. Options of a driver of your
own go in as ``**options``, where ``options`` is a ``dict[str, Any]``.
"""

import os
from collections.abc import Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any, Literal, TypeAlias, overload, type_check_only

from strands_actors.surfaces.agents.approval import Approve
from strands_actors.surfaces.mesh.config import MeshConfig

from .async_robot import AsyncRobot as AsyncRobot
from .envelopes import Answer
from .real_robot import RealRobot as RealRobot
from .sim_robot import SimRobot as SimRobot
'''


class Kind(NamedTuple):
    """A driver class, with the names by which its robots are known."""

    name: str
    driver: type[Driver]
    robots: tuple[str, ...]

    @property
    def alias(self) -> str:
        return f"{self.name}Name"


def kinds() -> list[Kind]:
    """Return the drivers of this package, without drivers that other packages registered."""
    found = []
    for where in WIRES.values():
        driver: type[Driver] = load(where)
        others = {**SHORT_NAMES, **{kind.type: robot for robot, kind in TYPES.items()}, **driver.ALIASES}
        named = [name for name, robot in others.items() if robot in driver.SUPPORTED_ROBOTS]
        robots = tuple(dict.fromkeys((*sorted(driver.SUPPORTED_ROBOTS), *sorted(named))))
        found.append(Kind(driver_name(driver).removesuffix("Driver"), driver, robots))
    return sorted(found)


def only_lerobots(known: Iterable[Kind]) -> tuple[str, ...]:
    """Return the names of robots that only LeRobot drives."""
    ours = {name for kind in known for name in kind.robots}
    return tuple(sorted({name for robot, kind in TYPES.items() for name in (robot, kind.type)} - ours))


# -- types and values as text


def written(hint: Any, is_path: bool = False) -> str:
    """Return the type that a caller may pass: any sequence for a tuple, any mapping for a dict."""
    if isinstance(hint, str):
        return hint
    if hint is types.NoneType:
        return "None"
    if hint is str:
        return "str | os.PathLike[str]" if is_path else "str"
    origin, args = get_origin(hint), get_args(hint)
    if origin is Literal:
        return literal(args)
    if origin in (Union, types.UnionType):
        return " | ".join(written(each, is_path) for each in args)
    if origin in (tuple, list):
        return f"Sequence[{written(args[0])}]"
    if origin is dict:
        return f"Mapping[{', '.join(map(written, args))}]"
    return "Any" if hint is Any else str(hint.__name__)


def literal(values: Iterable[object]) -> str:
    return f"Literal[{', '.join(quoted(each) if isinstance(each, str) else repr(each) for each in values)}]"


def quoted(text: str) -> str:
    return f'"{text}"'


def default(value: object) -> str:
    if isinstance(value, str):
        return quoted(value) if len(value) <= 20 else "..."
    if value is None or isinstance(value, bool | int) or (isinstance(value, float) and math.isfinite(value)):
        return repr(value)
    return "..."


def packed(head: str, parts: Iterable[str], tail: str) -> str:
    """Return a definition, with its parameters on separate lines if they do not fit on one."""
    parts_list = list(parts)
    if len(line := f"{head}{', '.join(parts_list)}{tail}") <= WIDTH:
        return line
    lines = [""]
    for part in parts_list:
        if len(lines[-1]) + len(part) + 2 > WIDTH - 4:
            lines.append("")
        lines[-1] += f"{part}, "
    return "\n".join([head, *(f"    {line.rstrip()}" for line in lines), tail])


# -- keywords


def options_of(driver: type[Driver], names: Iterable[str] | None = None) -> Iterator[str]:
    """Yield the driver's own keywords, in every spelling; only those with these names, if names are given."""
    meanings = driver.OPTIONS
    assert isinstance(meanings, Meanings), f"{driver.__name__}.OPTIONS is not made by meanings()"
    hints = get_type_hints(meanings.options, include_extras=True)
    plain = get_type_hints(meanings.options)
    spellings = {own: other for other, own in driver.SPELLINGS.items()}
    for field in msgspec.structs.fields(meanings.options):
        if names is not None and field.name not in names:
            continue
        if field.name == "transport":
            continue  # ``transports`` lists it together with ``twin``
        metas = getattr(hints[field.name], "__metadata__", ())
        is_path = any((meta.extra or {}).get("is_path") for meta in metas)
        for name in (field.encode_name, spellings.get(field.encode_name)):
            if name is not None:
                yield f"{name}: {written(plain[field.name], is_path)} = {default(field.default)}"


def factory_keywords(left_out: Iterable[str], narrowed: Mapping[str, str]) -> Iterator[str]:
    """Yield the keywords of ``Robot`` itself. ``attach`` has an overload of its own."""
    for one in inspect.signature(factory.Robot).parameters.values():
        if one.kind is one.KEYWORD_ONLY and one.name not in (*left_out, "attach"):
            yield f"{one.name}: {narrowed.get(one.name, one.annotation)} = {default(one.default)}"


def transports(driver: type[Driver]) -> str:
    offered = (*driver.TRANSPORTS, *(("serial",) if driver.PORT_KIND == "serial" else ()))
    return f"{literal(offered)} | None"


def overloads(function: str, known: list[Kind], returns: Mapping[str, str]) -> Iterator[str]:
    """Yield the overloads of a factory. ``returns`` maps each kind, and ``real`` and ``sim`` for any robot, to
    the returned handle."""
    ours = {"driver": literal(("auto", "strands"))}
    simulated = {"driver": literal(("auto", "strands", "lerobot")), "backend": literal(BACKENDS)}
    others = {transport for kind in known for transport in kind.driver.TRANSPORTS} - {"twin"}
    anything = f"{literal(('twin', 'serial', *sorted(others)))} | None"

    def one(name: str, mode: str, keywords: Iterable[str], handle: str) -> str:
        return "@overload\n" + packed(
            f"def {function}(", [f"name: {name}", mode, "*", *keywords], f") -> {handle}: ..."
        )

    real = f"mode: {literal(('real', 'auto'))}"
    sim = 'mode: Literal["sim"] = "sim"'
    for kind in known:
        narrowed = {**ours, "transport": transports(kind.driver)}
        keywords = [*factory_keywords(OF_SIMULATIONS, narrowed), *options_of(kind.driver)]
        yield one(kind.alias, real, keywords, returns.get(f"real {kind.name}", returns["real"]))
    lerobots = [*factory_keywords((*OF_SIMULATIONS, "driver"), {"transport": "None"}), "**fields: Any"]
    yield one("LeRobotName", real, ['driver: Literal["auto", "lerobot"] = "auto"', *lerobots], returns["real"])
    yield one("str", real, ['driver: Literal["lerobot"]', *lerobots], returns["real"])
    # A robot of the user's own, which only its table describes.
    described_by = ['driver: Literal["auto", "strands", "ros2"] = "auto"', "table: str | Mapping[str, Any]"]
    yield one("str", real, [*described_by, *lerobots], returns["real"])
    yield one("str", real, factory_keywords(OF_SIMULATIONS, {**ours, "transport": anything}), returns["real"])
    for kind in known:
        handle = returns.get(f"sim {kind.name}")
        if handle or kind.driver.TWIN_OPTIONS:
            body = options_of(kind.driver, kind.driver.TWIN_OPTIONS)
            keywords = [*factory_keywords(OF_HARDWARE, simulated), *body]
            yield one(kind.alias, sim, keywords, handle or returns["sim"])
    yield one("str", sim, factory_keywords(OF_HARDWARE, simulated), returns["sim"])
    own = ["name: str", "*", "attach: Literal[True]", *factory_keywords(GIVEN_BY_HOST, {})]
    yield "@overload\n" + packed(f"def {function}(", own, f") -> {returns['real']}: ...")


# -- handles


def service(name: str, declared: Service, is_async: bool) -> str:
    parameters = ["self"]
    for argument, value in declared.arguments.items():
        if not argument.isidentifier():
            continue
        if value is None and declared.acts:
            parameters.append(f"{argument}: float | None = None")
            continue
        hint = "Any" if value is None or not isinstance(value, bool | int | float | str) else type(value).__name__
        parameters.append(f"{argument}: {hint} = {default(value)}")
    if name in WITH_ACTION:
        parameters += ["*", "action: Mapping[str, Any] | None = None"]
    if is_async:
        return packed(f"    async def {name}(", parameters, ") -> Answer: ...")
    about = f"{sentence_case(declared.about).removesuffix('.')}."
    text = textwrap.fill(f'        """{about}"""', WIDTH, subsequent_indent=" " * 8)
    return packed(f"    def {name}(", parameters, ") -> Answer:") + f"\n{text}"


JSON_TYPES = {"array": "Sequence[float]", "number": "float", "integer": "int", "string": "str", "boolean": "bool"}


def command(verb: ToolVerb, is_async: bool) -> str:
    """An agent's verb as a method."""
    parameters = ["self"]
    for name, schema in verb.inputs.items():
        if (key := name.replace(".", "_")).isidentifier():
            parameters.append(f"{key}: {JSON_TYPES.get(str(schema.get('type')), 'Any')} = ...")
    if verb.does == "action":
        parameters += ["*", "wait: bool = True"]
    if is_async:
        return packed(f"    async def {verb.name}(", parameters, ") -> Answer: ...")
    text = textwrap.fill(f'        """{verb.description}"""', WIDTH, subsequent_indent=" " * 8)
    return packed(f"    def {verb.name}(", parameters, ") -> Answer:") + f"\n{text}"


def described(kind: Kind) -> tuple[dict[str, Service], dict[str, ToolVerb]]:
    """Return the services and commands that are methods of the driver's robots."""
    services: dict[str, Service] = {}
    commands: dict[str, ToolVerb] = {}
    for robot in kind.driver.SUPPORTED_ROBOTS:
        options = kind.driver.resolve(robot, {})
        one = build_driver(kind.driver, robot, "", options)
        services |= kind.driver.services(options)
        commands |= {verb.name: verb for verb in one.TOOL_VERBS if verb.does != "service"}
    return services, commands


def handle(
    name: str, base: type, services: Mapping[str, Service], named: str = "", commands: Mapping[str, ToolVerb] = NONE
) -> str:
    """Return a class with services and commands as methods, or an empty text if it adds nothing to its base.
    ``named`` is the base, if it is a class of this file."""
    is_async = base is AsyncRobot
    methods = {key: service(key, each, is_async) for key, each in services.items() if not hasattr(base, key)}
    for key, verb in commands.items():
        if key not in methods and not hasattr(base, key):
            methods[key] = command(verb, is_async)
    if not methods:
        return ""
    bodies = "\n".join(methods.values())
    return f"@type_check_only\nclass {name}({named or base.__name__}):\n{bodies}"


def text() -> str:
    known = kinds()
    names = [f"{kind.alias}: TypeAlias = {literal(kind.robots)}" for kind in known]
    names.append(f"LeRobotName: TypeAlias = {literal(only_lerobots(known))}")
    classes: list[str] = []
    now: dict[str, str] = {"real": "RealRobot", "sim": "SimRobot"}
    later: dict[str, str] = {"real": "AsyncRobot", "sim": "AsyncSimulation"}
    simulation: type[Driver] = load("strands_actors.drivers.sim.driver:SimDriver")
    classes.append(handle(later["sim"], AsyncRobot, simulation.SERVICES))
    for kind in known:
        services, commands = described(kind)
        acts = {name: each for name, each in services.items() if each.acts}
        for names_of, key, name, base, of_it in (
            (now, "real", kind.name, RealRobot, services),
            (later, "real", f"Async{kind.name}", AsyncRobot, services),
            (now, "sim", f"Simulated{kind.name}", SimRobot, acts),
            (later, "sim", f"AsyncSimulated{kind.name}", AsyncRobot, acts),
        ):
            if made := handle(name, base, of_it, names_of[key], commands):
                classes.append(made)
                names_of[f"{key} {kind.name}"] = name
    context = {key: f"AbstractAsyncContextManager[{each}]" for key, each in later.items()}
    parts = [
        HEAD,
        "# -- names of robots, by their driver\n",
        "\n".join(wrapped(name) for name in names),
        "\n# -- handles with the services of one driver\n",
        "\n\n".join(classes),
        "\n# -- the factories\n",
        "\n".join(overloads("Robot", known, now)),
        "",
        "\n".join(overloads("open_robot", known, context)),
    ]
    return "\n".join(parts) + "\n"


def wrapped(assignment: str) -> str:
    if len(assignment) <= WIDTH:
        return assignment
    head, _, values = assignment.partition("Literal[")
    lines = textwrap.wrap(values.removesuffix("]"), WIDTH - 4)
    return "\n".join([f"{head}Literal[", *(f"    {line}" for line in lines), "]"])


if __name__ == "__main__":
    FILE.write_text(text())

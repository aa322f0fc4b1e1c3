"""Read ``clients.toml``: the clients of vendors, and the programs that use them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal

import msgspec

HERE = Path(__file__).parent
TABLE = HERE / "clients.toml"
OWN = HERE / "programs"


class Program(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One program of a client, and what the robot should do while it runs.

    Attributes:
        file: The file, below the client's folder of examples. Or ``own:NAME``, a file of ``programs/``,
            ``command:NAME``, a command that the client installs, or ``module:NAME`` for ``python -m NAME``.
            ``given:NAME`` is a file in a folder that a person names with ``--examples``.
        title: The name in the results. Empty: that of the file.
        arguments: Arguments of the program. None: those of the client.
        typed: The lines that a person types into the program, one each second.
        moves: The axes that should move, or True if any should, or False if the program only reads. None: an axis
            should move if the log of the wire has setpoints.
        reaches: Where axes should be at the end, in radians or metres of the body, or a name from the client's
            ``places``.
        passes: Where axes should turn on their way, in the same units: the extreme position of each.
        within: How far from ``reaches`` or ``passes`` an axis may be, in radians or metres.
        refusal: A regular expression. A text of the program that matches it is the robot's own error.
        lacks: Why the robot refuses this program, or what the twin does not model.
        broken: The fault of the program itself. The text of the fault matches ``refusal``.
        note: What a reader of the result should know.
        endless: True if the program runs until a person ends it.
        seconds: The time after which the program is ended.
        settles: For how long the robot may go on after the end, because the client does not wait for its last move.
        robot: Another robot than the client's.
        options: Further options of the twin.
        replaces: Further addresses in the program's text, and what replaces them.
    """

    file: str
    title: str = ""
    arguments: tuple[str, ...] | None = None
    typed: tuple[str, ...] = ()
    moves: bool | tuple[str, ...] | None = None
    reaches: Mapping[str, float] = {}
    passes: Mapping[str, float] = {}
    within: float = 0.05
    refusal: str = ""
    lacks: str = ""
    broken: str = ""
    note: str = ""
    endless: bool = False
    seconds: float = 60.0
    settles: float = 0.0
    robot: str = ""
    options: Mapping[str, bool | int | float | str] = {}
    replaces: Mapping[str, str] = {}

    @property
    def name(self) -> str:
        return self.title or self.file.rpartition(":")[2]


class Client(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A client as its vendor publishes it, and its programs.

    Attributes:
        name: Its package.
        version: The version that is fetched.
        license: The license of the package. It only says why nothing of it is copied.
        robot: The robot that its programs use.
        index: Where the package is: PyPI or npm.
        python: The version of Python that it needs. Empty: this one.
        needs: Further packages.
        alone: True if it is installed without the packages that it lists.
        empty: Modules that it imports and that no program uses. Empty files replace them.
        examples: Where its examples are: in the installed package (``wheel``), or in its source distribution
            (``sdist``).
        folder: The folder of the examples there.
        every: Patterns of files below that folder. Each file that fits is a program without a row, too.
        arguments: Arguments of each program.
        typed: The lines that a person types into each program that asks, such as the address.
        replaces: Addresses in the texts of its examples, and what replaces them.
        prelude: Python that runs before a program. It sets only host, port, certificate or login.
        environment: Environment variables.
        options: Options of the twin.
        places: Positions of all axes that several programs end at, by name.
        program: Its programs.
        part: Only programs that fit ``every`` and have this text in their name.
    """

    name: str
    version: str
    license: str
    robot: str
    index: Literal["pypi", "npm"] = "pypi"
    python: str = ""
    needs: tuple[str, ...] = ()
    alone: bool = False
    empty: tuple[str, ...] = ()
    examples: Literal["", "wheel", "sdist"] = ""
    folder: str = ""
    every: tuple[str, ...] = ()
    arguments: tuple[str, ...] = ("{host}",)
    typed: tuple[str, ...] = ()
    replaces: Mapping[str, str] = {}
    prelude: str = ""
    environment: Mapping[str, str] = {}
    options: Mapping[str, bool | int | float | str] = {}
    places: Mapping[str, Mapping[str, float]] = {}
    program: tuple[Program, ...] = ()
    part: str = ""

    @property
    def pin(self) -> str:
        """Its name and version, as the index's own tool takes them."""
        return f"{self.name}{'@' if self.index == 'npm' else '=='}{self.version}"


def clients(path: Path = TABLE) -> tuple[Client, ...]:
    """Return the clients of a table.

    Raises:
        ValueError: The table is not valid. The text has the reason.
    """
    rows = tomllib.loads(path.read_text())
    for row in rows["client"]:
        for program in row.get("program", ()):
            if isinstance(name := program.get("reaches"), str):
                if name not in row.get("places", {}):
                    raise ValueError(f"{path.name}: {row['name']} has no place {name!r}")
                program["reaches"] = row["places"][name]
    try:
        found = msgspec.convert(rows["client"], tuple[Client, ...])
    except msgspec.ValidationError as wrong:
        raise ValueError(f"{path.name}: {wrong}") from None
    if problems := [text for client in found for text in _problems(client)]:
        raise ValueError(f"{path.name}: {'. '.join(problems)}")
    return found


def _problems(client: Client) -> Iterator[str]:
    names = [program.name for program in client.program]
    for name in {name for name in names if names.count(name) > 1}:
        yield f"{client.name} has {name} twice"
    for program in client.program:
        kind, _, rest = program.file.rpartition(":")
        if kind == "own" and not (OWN / rest).is_file():
            yield f"{client.name}: programs/{rest} does not exist"
        if not kind and not client.examples:
            yield f"{client.name}: {program.file} is an example, and the row does not say where examples are"
        if (program.reaches or program.passes) and program.moves is False:
            yield f"{client.name}: {program.file} cannot reach a place without a move"
        if (program.lacks or program.broken) and not program.refusal:
            yield f"{client.name}: {program.file} fails for a reason, so `refusal` must say how the failure reads"


__all__ = ["HERE", "OWN", "TABLE", "Client", "Program", "clients"]

"""Run one program of a client against a fresh twin, and return what was seen."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from strands_actors.surfaces.cli.robots import driver_of_twin
from strands_actors.testing import WireLog
from tests.drivers.common.twin_process import TwinProcess

from .body import Watch
from .fetch import Fetched
from .table import HERE, OWN, Client, Program
from .verdict import Judged, Seen, judge

END_S = 10.0
"""Seconds from the interrupt, which a person sends to an endless program, to its end by force."""
TYPE_S = 1.0
OUTPUT = 20_000
"""The last characters of a program's output that are kept."""
LAUNCHER = "launcher.py"
STUBS = HERE.parent / "peers" / "stubs"
"""Stands for PyGObject, which a client imports for sound and which would have to be compiled."""


class Outcome(NamedTuple):
    """One run of a program, and the verdict on it."""

    client: Client
    program: Program
    robot: str
    seen: Seen
    judged: Judged
    took_s: float


def run(client: Client, program: Program, fetched: Fetched, keep: Path | None = None) -> Outcome:
    """Run a program against a fresh twin of its robot.

    Args:
        client: The row of the client.
        program: The row of the program.
        fetched: The client in the cache.
        keep: The folder in which the log of the wire and the output stay. None: they are removed.
    """
    robot, driver = driver_of_twin(program.robot or client.robot)
    wire = driver.TWIN.partition(":")[0].split(".")[2]
    with tempfile.TemporaryDirectory(prefix="strangers-") as temporary:
        folder = Path(temporary)
        options = {**client.options, **program.options}
        control = folder / "control"
        extra = {"control": str(control), "on_wire": True, "options": options}
        with TwinProcess(folder, robot, wire, **extra) as twin:
            places = places_of(twin.port, fetched)
            command, directory = prepare(client, program, fetched, folder, places)
            environment = {name: fill(value, places) for name, value in client.environment.items()}
            typed = [fill(line, places) for line in program.typed or client.typed]
            began_s = time.monotonic()
            with Watch(control) as watch:
                code, output = execute(command, directory, folder, typed, program.seconds, environment)
                time.sleep(program.settles)
            took_s = time.monotonic() - began_s
        entries = list(WireLog(twin.log_path).entries())
        calls = Counter(entry.kind for entry in entries if entry.sender == "host")
        errors = tuple(
            entry.data.decode(errors="replace")
            for entry in entries
            if entry.sender == "robot" and entry.kind == "error"
        )
        if keep is not None:
            store(keep / f"{client.name}-{program.name.replace('/', '-')}", output, twin.log_path)
    seen = Seen(code, output, dict(calls), watch.way.rows, watch.way.moved(), watch.lost, errors)
    return Outcome(client, program, robot, seen, judge(program, seen), took_s)


def places_of(port: str, fetched: Fetched) -> dict[str, str]:
    """Return what ``{host}``, ``{port}`` and so on stand for in the table.

    Args:
        port: The address as the twin publishes it: a path, or ``host:port`` with options after a ``?``.
        fetched: The client in the cache.
    """
    address, _, query = port.strip().partition("?")
    host, colon, number = address.rpartition(":")
    options = dict(text.partition("=")[::2] for text in query.split("&") if text)
    return {
        **options,
        "address": address,
        "host": host if colon else address,
        "port": number if colon else "",
        "folder": str(Path(address).parent),
        "modules": str(fetched.modules or ""),
        "stubs": str(STUBS),
    }


def fill(text: str, places: Mapping[str, str]) -> str:
    """Return a text of the table with ``{host}`` and so on replaced. Other braces stay."""
    for name, value in places.items():
        text = text.replace(f"{{{name}}}", value)
    return text


def prepare(
    client: Client, program: Program, fetched: Fetched, folder: Path, places: Mapping[str, str]
) -> tuple[list[str], Path]:
    """Return the command of a program, and the directory in which it runs.

    An example runs in a copy of its folder. Only addresses are replaced in the copy, as a person would do by hand.
    """
    kind, _, name = program.file.rpartition(":")
    arguments = client.arguments if program.arguments is None else program.arguments
    filled = [fill(argument, places) for argument in arguments]
    if kind == "command":
        return [str(fetched.commands / name), *filled], folder
    if kind == "module":
        return [str(fetched.python), "-m", name, *filled], folder
    if kind == "own":
        file = OWN / name
    else:
        assert fetched.examples is not None
        copied = folder / "examples"
        shutil.copytree(fetched.examples, copied)
        file = copied / name
        replace({**client.replaces, **program.replaces}, file, places)
    if fetched.modules is not None:
        return [str(fetched.python), str(file), *filled], file.parent
    launcher = folder / LAUNCHER
    launcher.write_text(_launcher(fill(client.prelude, places)))
    return [str(fetched.python), "-W", "ignore", str(launcher), str(file), *filled], file.parent


def replace(addresses: Mapping[str, str], file: Path, places: Mapping[str, str]) -> None:
    """Replace addresses in a program's text.

    Raises:
        ValueError: The text does not have an address. Then the row is for another version.
    """
    text = file.read_text()
    for address, place in addresses.items():
        if address in text:
            text = text.replace(address, fill(place, places))
    file.write_text(text)


def _launcher(prelude: str) -> str:
    """Return a program that runs another one as Python does, after it has set host and port."""
    return f"""import os, runpy, sys
sys.argv = sys.argv[1:]
sys.path[0] = os.path.dirname(os.path.abspath(sys.argv[0]))
{prelude}
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def execute(
    command: list[str],
    directory: Path,
    home: Path,
    typed: Sequence[str],
    seconds: float,
    environment: Mapping[str, str],
) -> tuple[int | None, str]:
    """Run a command, and return its exit code and the end of its output. The code is None if it was ended."""
    given = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "STRANDS_"))}
    given |= {"HOME": str(home), "PYTHONUNBUFFERED": "1", "MPLBACKEND": "Agg", **environment}
    with (home / "output").open("w+", errors="replace") as output:
        process = subprocess.Popen(
            command,
            cwd=directory,
            env=given,
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=output,
            text=True,
            start_new_session=True,
        )
        typist = threading.Thread(target=_type, args=(process, typed))
        typist.start()
        try:
            code: int | None = process.wait(seconds)
        except subprocess.TimeoutExpired:
            code = None
            os.killpg(process.pid, signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
        finally:
            # Also its children, which would go on using the robot.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            typist.join()
        output.seek(0)
        return code, output.read()[-OUTPUT:]


def _type(process: subprocess.Popen[str], lines: Sequence[str]) -> None:
    """Type lines into a program, one each second, and then end its input."""
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError), process.stdin:
        for line in lines:
            time.sleep(TYPE_S)
            process.stdin.write(f"{line}\n")
            process.stdin.flush()


def store(folder: Path, output: str, log: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "output.txt").write_text(output)
    shutil.copy(log, folder / "wire.ndjson")


__all__ = ["Outcome", "fill", "places_of", "run"]

"""The command ``strands-actors``. Each command imports its modules only when it runs, so that --help is
quick."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from json import dumps as json_of  # commands have an option named "json"
from pathlib import Path
from typing import Annotated

import typer

from strands_actors.contract.extras import MissingExtra
from strands_actors.surfaces.recording.errors import RecordingError

from .errors import Problem
from .options import All, Every, Json, Kind, Mesh, What, Which, finite, one_or_all
from .stop_forms import spelled

USAGE = 2
INTERRUPTED = 130

app = typer.Typer(
    name="strands-actors",
    help="Robots as supervised trees of actors.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


def _version(wanted: bool) -> None:
    if wanted:
        from strands_actors.version import __version__

        print(f"strands-actors {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Robots as supervised trees of actors."""


@app.command()
def demo(
    seconds: Annotated[
        float, typer.Option(min=6.0, callback=finite, help="Length, without the time processes need.")
    ] = 12.0,
    no_faults: Annotated[bool, typer.Option("--no-faults", help="Only run the policy.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, nothing else.")] = False,
    out: Annotated[Path, typer.Option(help="Where the picture goes.")] = Path("demo.png"),
) -> None:
    """Kill a running arm, process by process, and measure."""
    from .demo import run

    raise typer.Exit(run(seconds, faults=not no_faults, as_json=json, out=out))


@app.command("list")
def list_(all_: Every = False, json: Json = False) -> None:
    """List the robots that this machine can drive, and by which driver."""
    from .robots import show_robots

    show_robots(as_json=json, every=all_)


@app.command()
def tree(json: Json = False) -> None:
    """Show the running robots: their processes and actors."""
    from .trees import show_trees

    raise typer.Exit(show_trees(as_json=json))


@app.command()
def top() -> None:
    """Show the running robots live; stop, e-stop and resume by a key."""
    from .top import run as show

    raise typer.Exit(show())


@app.command()
def doctor(json: Json = False) -> None:
    """Find out what this machine lacks to run robots, with remedies."""
    from .doctor import run as examine

    raise typer.Exit(examine(as_json=json))


@app.command()
def stop(robot: Which = None, all_: All = False, mesh: Mesh = None, json: Json = False) -> None:
    """De-energise a robot."""
    from .orders import stop as run

    raise typer.Exit(run(robot, all_, mesh, as_json=json))


@app.command()
def estop(robot: Which = None, all_: All = False, mesh: Mesh = None, json: Json = False) -> None:
    """De-energise every robot, or one, and lock it until `resume`."""
    from .orders import estop as run

    raise typer.Exit(run(robot, all_, mesh, as_json=json))


@app.command()
def resume(robot: Which = None, all_: All = False, mesh: Mesh = None, json: Json = False) -> None:
    """Lift a lockout and energise a robot; starts no motion."""
    from .orders import resume as run

    one_or_all("resume", robot, all_)
    raise typer.Exit(run(robot, all_, mesh, as_json=json))


@app.command()
def echo(
    what: What,
    mesh: Mesh = None,
    json: Json = False,
    count: Annotated[int | None, typer.Option(min=1, help="End after so many samples.")] = None,
    timeout: Annotated[
        float | None, typer.Option(min=0.1, callback=finite, help="End when nothing comes for so long.")
    ] = None,
) -> None:
    """Show what a robot publishes."""
    from .listen import echo as run

    run(what, mesh, as_json=json, count=count, timeout_s=timeout)


@app.command()
def trace(
    robot: Annotated[str, typer.Argument(help="As `tree` names it.")],
    count: Annotated[int | None, typer.Option(min=1, help="End after so many messages.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.1, callback=finite, help="End after so long.")] = None,
    json: Json = False,
) -> None:
    """Print the messages between a robot's actors: sender, receiver, type, age. For this user's robots
    only."""
    from .trace import trace as run

    run(robot, json, count, seconds)


@app.command()
def hz(
    what: What,
    mesh: Mesh = None,
    json: Json = False,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, callback=finite, help="Listen so long, then end.")
    ] = None,
) -> None:
    """Measure how often a robot publishes each topic."""
    from .listen import hz as run

    run(what, mesh, as_json=json, seconds=seconds)


@app.command()
def send(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Its name, as `mesh status` shows it.")],
    targets: Annotated[list[str], typer.Argument(metavar="JOINT=NUMBER...", help="In the robot's units.")],
    seconds: Annotated[float, typer.Option("--for", min=0.0, callback=finite, help="Then the robot holds.")] = 2.0,
    resume: Annotated[bool, typer.Option("--resume", help="Energise it first.")] = False,
    mesh: Mesh = None,
    json: Json = False,
) -> None:
    """Move a robot. Its lease must be free."""
    from .send import send as run

    raise typer.Exit(run(robot, targets, seconds, resume, mesh, as_json=json))


@app.command()
def calibrate(
    robot: Kind,
    port: Annotated[str, typer.Option(help="Its serial port.")],
    id_: Annotated[str | None, typer.Option("--id", help="Its name; the file is called so.")] = None,
    json: Json = False,
) -> None:
    """Calibrate the joints of a robot or a leader, by moving them by hand."""
    from .calibrate import calibrate as run

    raise typer.Exit(run(robot, port, id_, json))


@app.command("setup-motors")
def setup_motors(
    robot: Kind,
    port: Annotated[str, typer.Option(help="Its serial port.")],
    joint: Annotated[list[str] | None, typer.Option(help="Only this one.")] = None,
    json: Json = False,
) -> None:
    """Give new servos their ids, one after the other."""
    from .calibrate import setup_motors as run

    raise typer.Exit(run(robot, port, joint or [], json))


@app.command()
def ports(
    also: Annotated[list[str] | None, typer.Option(metavar="PATH", help="Look at these, too.")] = None,
    json: Json = False,
) -> None:
    """Find out which serial adapter belongs to a robot, by unplugging it."""
    from .calibrate import ports as run

    raise typer.Exit(run(also or [], json))


@app.command()
def teleop(
    robot: Kind,
    leader: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="LEADER",
            help="NAME:PORT or NAME:PORT:ID of a leader arm, keyboard, lerobot:TYPE, module:Class; page, gamepad "
            "and phone are one page, :ADDRESS:PORT of it for your network.",
        ),
    ],
    port: Annotated[str | None, typer.Option(help="Of a real robot: its serial port or address.")] = None,
    twin: Annotated[bool, typer.Option("--twin", help="Lead its twin; without a port: a simulation.")] = False,
    deadman: Annotated[str | None, typer.Option(help="`key`: the space bar; `gripper`: the leader's.")] = None,
    relative: Annotated[bool, typer.Option("--relative", help="Lead from where both are when engaged.")] = False,
    hz: Annotated[float, typer.Option(callback=finite, help="Setpoints a second.")] = 100.0,
    max_speed: Annotated[
        float | None, typer.Option(callback=finite, help="Degrees a second; quicker frames are refused.")
    ] = None,
    map_: Annotated[str | None, typer.Option("--map", metavar="MODULE:FUNCTION", help="Leader to robot.")] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, callback=finite, help="How long; else until a key.")
    ] = None,
    id_: Annotated[str | None, typer.Option("--id", help="The robot's name, and its calibration's.")] = None,
    leader_id: Annotated[str | None, typer.Option(help="The leader's: as it was calibrated with --id.")] = None,
    json: Json = False,
) -> None:
    """Lead a robot by a leader arm, or by keys. It follows while the dead-man is held."""
    from .teleop import teleop as run

    led_by = leader, leader_id
    raise typer.Exit(run(robot, led_by, port, twin, deadman, relative, hz, max_speed, map_, seconds, id_, json))


meshes = typer.Typer(name="mesh", help="Who is on the mesh, and who may be.", add_completion=False)
app.add_typer(meshes)


@meshes.command()
def status(mesh: Mesh = None, json: Json = False) -> None:
    """List the robots on the mesh."""
    from .mesh import status as run

    run(mesh, as_json=json)


@meshes.command()
def keys(
    directory: Annotated[Path, typer.Argument(help="Where they go.")],
    robot: Annotated[list[str] | None, typer.Option(help="A robot, by its name on the mesh: one each.")] = None,
    host: Annotated[list[str] | None, typer.Option(help="Under which these robots are connected to.")] = None,
    name: Annotated[list[str] | None, typer.Option(help="Of one more who watches or commands.")] = None,
    days: Annotated[int, typer.Option(min=1, max=36_500, help="For which they are valid.")] = 365,
    json: Json = False,
) -> None:
    """Make a certificate authority, and certificates for robots, operator and viewer. Run it again for
    more robots: the authority is kept."""
    from .mesh import keys as run

    run(directory, robot or [], host or [], name or [], days, as_json=json)


@app.command()
def record(
    context: typer.Context,
    robot: Annotated[str, typer.Argument(help="Its name, as `tree` shows it.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="The file, MCAP. It must not exist yet.")] = None,
    seconds: Annotated[
        float | None,
        typer.Option(min=0.0, callback=finite, help="How long; else until Ctrl-C. Of a dataset: each episode."),
    ] = None,
    dataset: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Record episodes there, in LeRobot's format.")
    ] = None,
    task: Annotated[str, typer.Option(help="Of a dataset: what is shown, in a sentence.")] = "",
    episodes: Annotated[int | None, typer.Option(min=1, help="Of a dataset: end after so many.")] = None,
    fps: Annotated[int, typer.Option(min=1, max=240, help="Of a dataset.")] = 30,
    camera: Annotated[list[str] | None, typer.Option(help="Of a dataset: a camera of the robot's.")] = None,
    codec: Annotated[
        str | None,
        typer.Option(help="Of its videos: av1, or mpeg4 for a small processor. A dataset keeps its own."),
    ] = None,
    keys: Annotated[
        str | None,
        typer.Option(
            metavar="page|gamepad|phone", help="Of a dataset: the episode keys on a page, too. :ADDRESS:PORT."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Record all commands, decisions and actions of a running robot; or episodes for training."""
    if (out is None) == (dataset is None):
        which = "-o FILE, or --dataset DIR" if out is None else "-o FILE or --dataset DIR: one of the two"
        raise Problem(f"record: give {which}")
    if dataset is not None:
        from strands_actors.surfaces.dataset.session import Order

        from .dataset import record as record_dataset

        order = Order(robot, os.path.abspath(dataset), task, fps, tuple(camera or ()), codec, episodes, seconds)
        raise typer.Exit(record_dataset(order, keys, as_json=json))
    of_datasets = ("task", "episodes", "fps", "camera", "codec", "keys")
    sources = {name: context.get_parameter_source(name) for name in of_datasets}
    given = [name for name, source in sources.items() if source is not None and source.name != "DEFAULT"]
    if given:
        raise Problem(f"record: --{', --'.join(given)}: of a dataset's episodes. give --dataset DIR")
    assert out is not None
    from .record import record as run

    raise typer.Exit(run(robot, out, seconds, as_json=json))


datasets = typer.Typer(name="dataset", help="Datasets that `record --dataset` wrote.", add_completion=False)
app.add_typer(datasets)
DatasetDirectory = Annotated[Path, typer.Argument(metavar="DIR", help="The dataset.")]


@datasets.command("show")
def show_dataset(root: DatasetDirectory, json: Json = False) -> None:
    """List the episodes of a dataset, and their defects."""
    from .dataset import show as run

    raise typer.Exit(run(root, as_json=json))


@datasets.command("play")
def play_dataset(
    root: DatasetDirectory,
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Its name, as `mesh status` shows it.")],
    episode: Annotated[int, typer.Option(min=0, help="Its number.")] = 0,
    units: Annotated[
        str, typer.Option(metavar="UNIT|normalized", help="Of its numbers, where the dataset does not say.")
    ] = "",
    resume: Annotated[bool, typer.Option("--resume", help="Energise it first.")] = False,
    mesh: Mesh = None,
    json: Json = False,
) -> None:
    """Move a robot along an episode. Its lease must be free."""
    from .play import play as run

    raise typer.Exit(run(root, robot, episode, units, resume, mesh, as_json=json))


@datasets.command("repair")
def repair_dataset(
    root: DatasetDirectory,
    drop: Annotated[bool, typer.Option("--drop", help="Remove instead what nobody has finished.")] = False,
    json: Json = False,
) -> None:
    """Make episodes of the files that a killed recorder has left."""
    from .dataset import repair as run

    raise typer.Exit(run(root, drop, as_json=json))


@datasets.command("compact")
def compact_dataset(
    root: DatasetDirectory,
    out: Annotated[Path, typer.Option("-o", "--out", help="Where the copy goes.")],
    json: Json = False,
) -> None:
    """Copy a dataset into few files, as LeRobot lays them out."""
    from .dataset import compact as run

    raise typer.Exit(run(root, out, as_json=json))


@datasets.command("convert")
def convert_dataset(
    root: DatasetDirectory,
    out: Annotated[Path, typer.Option("-o", "--out", help="Where the copy goes.")],
    json: Json = False,
) -> None:
    """Copy a dataset of LeRobot's version 2.0 or 2.1 as version 3."""
    from .dataset import convert as run

    raise typer.Exit(run(root, out, as_json=json))


@app.command()
def replay(
    recording: Annotated[Path, typer.Argument(help="A file that `record` wrote.")],
    json: Json = False,
) -> None:
    """Repeat every decision of a recording, and compare."""
    from .record import replay as run

    raise typer.Exit(run(recording, as_json=json))


@app.command()
def twin(
    robot: Kind,
    port_file: Annotated[Path, typer.Option(help="Is written with the twin's port (or address).")],
    log: Annotated[Path | None, typer.Option(help="One JSON line for each frame on the wire.")] = None,
    fault: Annotated[str | None, typer.Option(metavar="WORD[:servo]", help="A fault it begins with.")] = None,
    option: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE", help="An option of its twin.")] = None,
    control: Annotated[Path | None, typer.Option(help="A socket by which its joints are moved as by hand.")] = None,
    parent_fd: Annotated[int | None, typer.Option(hidden=True, help="Ends with the twin's parent.")] = None,
) -> None:
    """Serve a robot's twin until interrupted."""
    from .robots import serve_twin

    serve_twin(robot, port_file, log, fault, parent_fd, control, option or [])


@app.command()
def mcp(
    robot: Annotated[str, typer.Argument(help="As `list` names it.")],
    port: Annotated[str | None, typer.Option(help="Where the robot is.")] = None,
    transport: Annotated[str | None, typer.Option(help="`twin`: its twin, behind its real wire.")] = None,
    allow_motion: Annotated[bool, typer.Option("--allow-motion", help="Without, nothing is energised.")] = False,
) -> None:
    """Serve a robot as a tool over MCP, on standard input and output."""
    from .mcp import serve_mcp

    serve_mcp(robot, port, transport, allow_motion)


@app.command()
def drill(
    robot: Kind,
    port: Annotated[str | None, typer.Option(help="Of a real robot: its serial port or address.")] = None,
    twin: Annotated[bool, typer.Option("--twin", help="Drill its twin.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Consent was given elsewhere.")] = False,
    option: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE", help="A keyword of Robot().")] = None,
    json: Json = False,
) -> None:
    """Prove that the robot in front of you can be stopped; keeps a certificate."""
    from .drill import run as drill_robot

    raise typer.Exit(drill_robot(robot, port, twin, yes, option or [], as_json=json))


@app.command()
def matrix(
    drivers: Annotated[str | None, typer.Option(help="Robots, with commas. Default: one of each driver.")] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Trials a cell.")] = 1,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write the page there; of other robots it keeps the columns.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Robots that are broken side by side.")] = 1,
    resume: Annotated[Path | None, typer.Option(help="Keep each trial there, and repeat none that it has.")] = None,
    pairs: Annotated[bool, typer.Option(help="Break two processes, one shortly after the other.")] = False,
    victims: Annotated[
        str | None, typer.Option(help="Measure only cells with one of these, with commas. Default: all.")
    ] = None,
    json: Json = False,
) -> None:
    """Break each process and link of the twins in turn, and measure."""
    from .matrix import run as measure

    raise typer.Exit(measure(drivers, repeats, out, json, jobs, resume, pairs, victims))


def main() -> None:
    """Run the console script."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code.

    A failure is one line on stderr and, with --json, also an object with ``error`` on stdout.

    Returns:
        0: The command succeeded.
        1: It ran, but without success (a robot is not confirmed safe, a recording differs).
        2: It could not run.
        130: It was interrupted.
    """
    try:
        return _run(arguments)
    except Ended as ended:
        if "--json" in arguments:
            print(json_of({"error": str(ended)}), flush=True)
        print(f"strands-actors: {ended}", file=sys.stderr)
        return USAGE


class Ended(Exception):
    """A command could not run. The text is the one line that explains why."""


def _run(arguments: Sequence[str]) -> int:
    try:
        command = typer.main.get_command(app)
        given = spelled(arguments, getattr(command, "commands", {}))
        code = command(given or ["--help"], prog_name="strands-actors", standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except BaseExceptionGroup as group:
        return _ended(group)
    except (Problem, MissingExtra, OSError) as problem:
        raise Ended(_line(str(problem))) from problem
    except Exception as error:
        usage = getattr(error, "format_message", None)  # an error of typer, in any of its versions
        if usage is None:
            raise
        raise Ended(_line(usage())) from error
    return code if isinstance(code, int) else 0


def _ended(error: BaseException) -> int:
    """Return the exit code for the first error of an exception group, or raise it."""
    first = error
    while isinstance(first, BaseExceptionGroup):
        first = first.exceptions[0]
    match first:
        case KeyboardInterrupt():
            return INTERRUPTED
        case BrokenPipeError():  # the reader of our output (``head``) has closed the pipe
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        case Problem() | RecordingError() | OSError():
            raise Ended(_line(str(first))) from error
    raise error


def _line(text: str) -> str:
    """Return a message as one line, with commands in the place of Python calls."""
    return " ".join(text.split()).replace("strands_actors.list_robots()", "`strands-actors list`")

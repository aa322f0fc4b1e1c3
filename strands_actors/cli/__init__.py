"""The command ``strands-actors``. Each command imports what it needs when it runs, so that --help is quick."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from .errors import Problem

USAGE = 2
INTERRUPTED = 130

app = typer.Typer(
    name="strands-actors",
    help="Robots as supervised trees of actors.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

Json = Annotated[bool, typer.Option("--json", help="Print JSON instead.")]
Which = Annotated[str | None, typer.Argument(metavar="[ROBOT]", help="Its name, as `tree` shows it.")]
All = Annotated[bool, typer.Option("--all", help="Every robot of this user.")]


@app.command()
def demo(
    seconds: Annotated[float, typer.Option(min=6.0, help="Length, without the time processes need.")] = 12.0,
    no_faults: Annotated[bool, typer.Option("--no-faults", help="Only run the policy.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, nothing else.")] = False,
    out: Annotated[Path, typer.Option(help="Where the picture goes.")] = Path("demo.png"),
) -> None:
    """Kill a running arm, process by process, and measure."""
    from .demo import run

    raise typer.Exit(run(seconds, faults=not no_faults, as_json=json, out=out))


@app.command("list")
def list_(json: Json = False) -> None:
    """The robots there are, and who drives them."""
    from .robots import show_robots

    show_robots(as_json=json)


@app.command()
def tree(json: Json = False) -> None:
    """The robots that run now: their processes and actors."""
    from .trees import show_trees

    show_trees(as_json=json)


@app.command()
def stop(robot: Which = None, all_: All = False) -> None:
    """De-energise a robot."""
    from .operate import stop as run

    raise typer.Exit(run(robot, every=all_))


@app.command()
def estop(robot: Which = None, all_: All = False) -> None:
    """De-energise a robot and lock it until `resume`."""
    from .operate import estop as run

    raise typer.Exit(run(robot, every=all_))


@app.command()
def resume(robot: Which = None, all_: All = False) -> None:
    """Lift a lockout and energise; starts no motion."""
    from .operate import resume as run

    raise typer.Exit(run(robot, every=all_))


@app.command()
def record(
    robot: Annotated[str, typer.Argument(help="Its name, as `tree` shows it.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The file, MCAP. It must not exist yet.")],
    seconds: Annotated[float | None, typer.Option(min=0.0, help="How long; else until Ctrl-C.")] = None,
    json: Json = False,
) -> None:
    """Record all that a running robot is told, decides and does."""
    from .record import record as run

    raise typer.Exit(run(robot, out, seconds, as_json=json))


@app.command()
def replay(
    recording: Annotated[Path, typer.Argument(help="A file that `record` wrote.")],
    json: Json = False,
) -> None:
    """Decide a recording anew, and compare every decision."""
    from .record import replay as run

    raise typer.Exit(run(recording, as_json=json))


@app.command()
def twin(
    robot: Annotated[str, typer.Argument(help="As `list` names it.")],
    port_file: Annotated[Path, typer.Option(help="Is written with the twin's port (or address).")],
    log: Annotated[Path | None, typer.Option(help="One JSON line for each frame on the wire.")] = None,
    fault: Annotated[str | None, typer.Option(metavar="WORD[:servo]", help="A fault it begins with.")] = None,
) -> None:
    """Serve a robot's twin until interrupted."""
    from .robots import serve_twin

    serve_twin(robot, port_file, log, fault)


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


def main() -> None:
    """Entry of the console script."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run one command; its exit code. What goes wrong is one line on stderr."""
    try:
        code = app(list(arguments) or ["--help"], prog_name="strands-actors", standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except (Problem, OSError) as problem:
        return _complain(str(problem))
    except Exception as error:
        usage = getattr(error, "format_message", None)  # typer's own, whichever version
        if usage is None:
            raise
        return _complain(usage())
    return code if isinstance(code, int) else 0


def _complain(text: str) -> int:
    print(f"strands-actors: {' '.join(text.split())}", file=sys.stderr)
    return USAGE

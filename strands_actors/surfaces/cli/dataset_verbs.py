"""The commands ``dataset ...``. Each imports its modules only when it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .errors import Problem
from .options import Json, Mesh

datasets = typer.Typer(name="dataset", help="Datasets that `record --dataset` wrote.", add_completion=False)
DatasetDirectory = Annotated[Path, typer.Argument(metavar="DIR", help="The folder of the dataset.")]
Out = Annotated[Path, typer.Option("-o", "--out", help="The folder of the copy.")]


@datasets.command("show")
def show_dataset(root: DatasetDirectory, json: Json = False) -> None:
    """List the episodes of a dataset, and their defects."""
    from .dataset import show as run

    raise typer.Exit(run(root, as_json=json))


@datasets.command("play")
def play_dataset(
    root: DatasetDirectory,
    robot: Annotated[
        str | None, typer.Argument(metavar="ROBOT", help="The robot's name, as `mesh status` shows it.")
    ] = None,
    episode: Annotated[int, typer.Option(min=0, help="The number of the episode.")] = 0,
    units: Annotated[
        str, typer.Option(metavar="UNIT|normalized", help="Unit of the numbers, if the dataset states none.")
    ] = "",
    resume: Annotated[
        bool, typer.Option("--resume", help="Energise the robot first, also after an e-stop.")
    ] = False,
    twin: Annotated[
        bool, typer.Option("--twin", help="Play on a simulated robot, of the type that the dataset states.")
    ] = False,
    mesh: Mesh = None,
    json: Json = False,
) -> None:
    """Move a robot along a recorded episode. No other program may command the robot."""
    from .play import play as run
    from .play import play_on_twin

    if twin:
        if resume or mesh is not None:
            raise Problem("dataset play: --twin starts a robot of its own. Leave --resume and --mesh out")
        raise typer.Exit(play_on_twin(root, robot, episode, units, as_json=json))
    if robot is None:
        raise Problem("dataset play: give the name of a running robot, or --twin")
    raise typer.Exit(run(root, robot, episode, units, resume, mesh, as_json=json))


@datasets.command("repair")
def repair_dataset(
    root: DatasetDirectory,
    drop: Annotated[
        bool, typer.Option("--drop", help="Remove unfinished episodes instead of saving them.")
    ] = False,
    json: Json = False,
) -> None:
    """Save the episodes that a killed recorder has left unfinished."""
    from .dataset import repair as run

    raise typer.Exit(run(root, drop, as_json=json))


@datasets.command("copy")
def copy_dataset(
    root: DatasetDirectory,
    place: Annotated[
        str,
        typer.Argument(metavar="PLACE", help="A folder, s3://BUCKET/FOLDER or hf://datasets/USER/NAME."),
    ],
    verify: Annotated[
        bool, typer.Option("--verify", help="Also read every file there, and replace those that differ.")
    ] = False,
    json: Json = False,
) -> None:
    """Copy the episodes that a second place lacks."""
    from .dataset_copies import copy as run

    raise typer.Exit(run(root, place, verify, as_json=json))


@datasets.command("compact")
def compact_dataset(
    root: DatasetDirectory,
    out: Out,
    json: Json = False,
) -> None:
    """Copy a dataset into few large files, as LeRobot does."""
    from .dataset_copies import compact as run

    raise typer.Exit(run(root, out, as_json=json))


@datasets.command("convert")
def convert_dataset(
    root: DatasetDirectory,
    out: Out,
    json: Json = False,
) -> None:
    """Copy a dataset in LeRobot's format 2.0 or 2.1, and convert the copy to version 3."""
    from .dataset_copies import convert as run

    raise typer.Exit(run(root, out, as_json=json))


@datasets.command("label")
def label_dataset(
    root: DatasetDirectory,
    out: Out,
    episodes: Annotated[str, typer.Option(help="The episodes, such as 0-4,7, or good, or all.")],
    task: Annotated[str | None, typer.Option(help="Their new task, in a sentence.")] = None,
    mark: Annotated[
        str | None,
        typer.Option(help='A mark for them, such as failed. "" removes it. Marked ones are not good.'),
    ] = None,
    json: Json = False,
) -> None:
    """Copy a dataset, and give episodes another task or a mark."""
    from .dataset_copies import label as run

    raise typer.Exit(run(root, out, episodes, task, mark, as_json=json))


@datasets.command("split")
def split_dataset(
    root: DatasetDirectory,
    parts: Annotated[
        list[str],
        typer.Argument(metavar="PART=EPISODES", help="A new folder and its episodes: 0-4,7, or good, or 80%."),
    ],
    seed: Annotated[int | None, typer.Option(help="Choose the episodes of shares at random.")] = None,
    json: Json = False,
) -> None:
    """Copy parts of a dataset into separate datasets."""
    from .dataset_copies import split as run

    raise typer.Exit(run(root, parts, seed, as_json=json))


@datasets.command("merge")
def merge_datasets(
    roots: Annotated[list[Path], typer.Argument(metavar="DIR", help="The folders of the datasets, in order.")],
    out: Out,
    json: Json = False,
) -> None:
    """Copy several datasets of the same robot into one."""
    from .dataset_copies import merge as run

    raise typer.Exit(run(roots, out, as_json=json))


@datasets.command("report")
def report_dataset(
    root: DatasetDirectory,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="The page. Default: DIR.html beside DIR."),
    ] = None,
    json: Json = False,
) -> None:
    """Write a page about the quality of a dataset: pictures, lengths, ranges, jerks, duplicates, outliers."""
    from .dataset_report import report as run

    raise typer.Exit(run(root, out, as_json=json))

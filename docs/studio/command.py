"""``python -m docs pictures``: make the pictures of ``docs/pictures`` anew, without a display."""

from __future__ import annotations

import argparse
import functools
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from docs.site import facts

from . import console, demo, live, lowering, robots, terminal

FOLDER = Path(__file__).parents[1] / "pictures"

OTHERS: Mapping[str, tuple[str, Callable[[Path], None]]] = {
    "demo": ("demo.gif", demo.make),
    "top": ("top.svg", terminal.make_top),
    "drill": ("drill.svg", terminal.make_drill),
    "lowering": ("lowering.svg", lowering.make),
    "view": ("view.png", live.make),
    "console": ("console.png", console.make),
}
"""The pictures that are not of one robot: their files, and the functions that make them."""


def main(arguments: Sequence[str]) -> int:
    """Make the pictures that the command line names, or all of them. Return the exit code."""
    known = [*facts.robots(), *OTHERS]
    parser = argparse.ArgumentParser(
        prog="python -m docs pictures", description="Make pictures of the documentation, without a display."
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"a robot, or one of {', '.join(OTHERS)}; default: all"
    )
    parser.add_argument(
        "--samples", type=int, default=robots.SAMPLES, help="drawings of which a picture is the mean"
    )
    chosen = parser.parse_args(arguments)
    if unknown := [name for name in chosen.names if name not in known]:
        parser.error(f"there is no picture {', '.join(unknown)}. Use {', '.join(known)}")
    FOLDER.mkdir(exist_ok=True)
    for name, path, make in _pictures(chosen.names or known, chosen.samples):
        began = time.monotonic()
        try:
            make(path)
        except RuntimeError as failure:
            print(f"docs: {name}: {failure}", file=sys.stderr)
            return 1
        print(
            f"{name}: {path.name}, {path.stat().st_size / 1000:.0f} kB, {time.monotonic() - began:.0f} s",
            flush=True,
        )
    return 0


def _pictures(names: Sequence[str], samples: int) -> Iterator[tuple[str, Path, Callable[[Path], None]]]:
    for name in names:
        if name in OTHERS:
            file, make = OTHERS[name]
            yield name, FOLDER / file, make
        else:
            yield name, FOLDER / f"{name}.png", functools.partial(_portrait, name, samples)


def _portrait(robot: str, samples: int, path: Path) -> None:
    path.write_bytes(robots.png(robots.picture_of(robot, samples)))

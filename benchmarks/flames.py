"""Profile this package in a benchmark question: ``python -m benchmarks --flames [NAME ...]``.

The side (program) of the question that uses this package runs once more under py-spy. 250 times per second, py-spy
samples the call stacks of all its processes that compute at this moment. The samples are kept in
``benchmarks/results/flames`` and drawn as a flame graph: the width of a function is its share of the processor
time, and the functions that it called are above it.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
from collections import Counter
from html import escape
from pathlib import Path

from .house import OURS, RESULTS, Question, beneath

KEPT = RESULTS / "flames"
RATE_HZ = 250
LEAST = 0.004
"""Functions with a smaller share of the time are not drawn."""
WIDTH, ROW, LETTER = 1000, 17, 6.4
COLOURS = {"strands_actors": "#fdba74", "benchmarks": "#bbf7d0", "trio": "#bfdbfe"}
OTHERS = "#e2e8f0"

LINE = re.compile(r":\d+\)$")
FRAME = re.compile(r" \([^()]+\)$")
ENTRY_FRAMES = ("process ", "_run_code", "_run_module")
COMMAND = "(<string>)"
"""The file name in frames of a ``python -c`` program."""

Stacks = Counter[tuple[str, ...]]
"""Number of samples per stack. A stack goes from the outermost function to the one that computed."""


def record(question: Question, short: bool) -> Path:
    """Run the program of a question that uses this package once under py-spy, and store the samples.

    Args:
        question: The question.
        short: True runs the short form of the question.

    Returns:
        The file with the samples.

    Raises:
        RuntimeError: py-spy is not installed, or the run has failed.
    """
    spy = shutil.which(
        "py-spy", path=os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
    )
    if spy is None:
        raise RuntimeError("py-spy is not installed: pip install -e '.[bench]'")
    stacks: Stacks = Counter()
    with tempfile.TemporaryDirectory() as directory:
        paths: list[Path] = []

        def watched(command: list[str]) -> list[str]:
            paths.append(Path(directory) / f"{len(paths)}.txt")
            # nonblocking: a paused process looks frozen to the processes that watch it.
            options = ["--nonblocking", "--rate", f"{RATE_HZ}", "--subprocesses", "--function", "--format", "raw"]
            return [spy, "record", *options, "--output", str(paths[-1]), "--", *command]

        with beneath(watched):
            question.sides[OURS](short)
        for path in paths:
            stacks += read(path.read_text())
    if not question.imports:
        stacks = Counter({stack: count for stack, count in stacks.items() if not any(map(_imports, stack))})
    KEPT.mkdir(parents=True, exist_ok=True)
    kept = KEPT / f"{question.name}.txt"
    kept.write_text(written(stacks))
    return kept


def read(text: str) -> Stacks:
    """Parse py-spy's output into call stacks, with the number of samples of each.

    Process names are left out, because their commands may contain semicolons. Line numbers and the frames of the
    interpreter's start are left out, too. So are ``python -c`` programs, which serve only to occupy processors.
    """
    stacks: Stacks = Counter()
    for line in text.splitlines():
        stack, _, count = line.rpartition(" ")
        frames = [LINE.sub(")", frame) for frame in stack.split(";") if not frame.startswith(ENTRY_FRAMES)]
        frames = [frame for frame in frames if FRAME.search(frame)]
        if not all(frame.endswith(COMMAND) for frame in frames):
            stacks[tuple(frames)] += int(count)
    return stacks


def _imports(frame: str) -> bool:
    return "<frozen importlib._bootstrap" in frame


def written(stacks: Stacks) -> str:
    """Return the call stacks as text, one per line, with their numbers of samples. A function with too few samples
    is left out, and its samples count for its caller.
    """
    least = LEAST / 2 * stacks.total()
    wide = inclusive(stacks)
    short: Stacks = Counter()
    for stack, count in stacks.items():
        depth = len(stack)
        while depth and wide[stack[:depth]] < least:
            depth -= 1
        short[stack[:depth] or ("elsewhere (of little each)",)] += count
    return "".join(f"{';'.join(stack)} {count}\n" for stack, count in sorted(short.items()))


def inclusive(stacks: Stacks) -> Stacks:
    """Return the number of samples for each chain of calls, including the samples of the functions called at its
    end.
    """
    totals: Stacks = Counter()
    for stack, count in stacks.items():
        for depth in range(1, len(stack) + 1):
            totals[stack[:depth]] += count
    return totals


def heaviest(stacks: Stacks, most: int = 6) -> list[tuple[str, float]]:
    """Return the functions with most processor time, not counting the functions that they call, and the share of
    each in all samples (0 to 1). Calls into C count as the caller's own time.
    """
    own: Counter[str] = Counter()
    for stack, count in stacks.items():
        own[stack[-1]] += count
    return [(frame, count / stacks.total()) for frame, count in own.most_common(most)]


def draw(stacks: Stacks, path: Path) -> None:
    total = stacks.total()
    wide = inclusive(stacks)
    drawn = {stack: count for stack, count in wide.items() if count >= LEAST * total}
    height = ROW * max(map(len, drawn), default=1)
    boxes: list[str] = []
    # X-coordinate at which the next function that this stack calls is drawn.
    after: dict[tuple[str, ...], float] = {(): 0.0}
    for stack, count in sorted(drawn.items()):
        start = after[stack[:-1]]
        after[stack] = start
        after[stack[:-1]] = start + count
        boxes.append(_box(stack[-1], start / total, count / total, height - ROW * len(stack)))
    path.parent.mkdir(parents=True, exist_ok=True)
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="monospace">'
    path.write_text("\n".join([head, *boxes, "</svg>", ""]))


def _box(frame: str, left: float, share: float, top: int) -> str:
    name, _, place = frame.partition(" (")
    colour = next((colour for package, colour in COLOURS.items() if place.startswith(package)), OTHERS)
    room = int(share * WIDTH / LETTER) - 1
    text = name if len(name) <= room else name[: max(0, room - 1)] + "…" if room > 3 else ""
    x, y, width = left * WIDTH, top, share * WIDTH
    return (
        f'<g><title>{escape(frame)}: {share:.1%}</title><rect x="{x:.1f}" y="{y}" width="{width:.1f}" '
        f'height="{ROW - 1}" fill="{colour}" stroke="#fff" stroke-width="0.5"/>'
        f'<text x="{x + 3:.1f}" y="{y + 12}" font-size="10.5">{escape(text)}</text></g>'
    )

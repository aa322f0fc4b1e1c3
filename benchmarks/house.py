"""Run benchmarks. Each one is a question about speed, with several sides (programs that are compared) and goals
(limits for the figures of this package).

All sides of a question run within the same minutes. Each round runs every side once, in an order that is shuffled
by a seed, so that other load on the computer affects all sides. A ratio compares figures of the same round, and a
goal limits the median of the ratios.
"""

from __future__ import annotations

import contextlib
import datetime
import importlib
import json
import os
import pkgutil
import platform
import random
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

HOUSE = Path(__file__).resolve().parent
RESULTS = HOUSE / "results"
HIGHER_IS_BETTER = ("_per_s", "_hz", "_x")
"""Units of figures of which more is better. Of times, shares of a processor and memory, less is better."""
OURS = "ours"
"""The side that the goals judge. Every question has it."""

Figures = dict[str, float]
"""Values by the name of the figure, for example ``{"ask_p50_us": 9.9}``. The name ends with the unit."""

Side = Callable[[bool], Figures]
"""Runs one round of one side. The argument selects the short form (seconds at most)."""


@dataclass(frozen=True)
class Goal:
    """A limit for the ratio ``ours[figure] / beside[figure]``, where ``ours`` is the side (program) with this
    package and ``beside`` the name of another side. If ``beside`` is empty, it limits ``ours[figure]`` itself.
    """

    figure: str
    beside: str
    at_most: float | None = None
    at_least: float | None = None

    def __post_init__(self) -> None:
        if (self.at_most is None) == (self.at_least is None):
            raise ValueError(f"the goal for {self.figure} has both at_most and at_least, or neither. Give one")

    def met(self, value: float) -> bool:
        """Return True if ``value`` is within the limit of the goal."""
        if self.at_most is not None:
            return value <= self.at_most
        assert self.at_least is not None
        return value >= self.at_least


@dataclass(frozen=True)
class Question:
    name: str
    title: str
    sides: Mapping[str, Side]
    goals: tuple[Goal, ...]
    limit: str
    """The text on what limits our figure at present, with the evidence, in Markdown."""
    notice: str
    """The meaning of the result for a user of a robot, in Markdown."""
    rounds: int = 5
    short: bool = True
    """True if its short form runs in CI."""
    imports: bool = False
    """True if the question includes importing. Flame graphs of other questions leave imports out."""
    ground: str = ""
    """The side with the least work that is possible, without the parts that we add. It is judged like
    ours."""

    def __post_init__(self) -> None:
        if OURS not in self.sides:
            raise ValueError(f"{self.name} has no side {OURS!r}. Add it to {', '.join(self.sides)}")
        unknown = {self.ground, *(goal.beside for goal in self.goals)} - {"", *self.sides}
        names = ", ".join(self.sides)
        if unknown:
            raise ValueError(
                f"{self.name}: its goals name {', '.join(unknown)}. Name only some of its sides: {names}"
            )

    def lower_is_better(self, figure: str) -> bool:
        """Return True if a lower value of the figure is better: by its goal, or else by its unit."""
        for goal in self.goals:
            if goal.figure == figure:
                return goal.at_most is not None
        return not figure.endswith(HIGHER_IS_BETTER)

    def among(self, *sides: str) -> Question:
        """Return a copy of the question with only the given sides (programs) and the side of this package, and
        with only the goals that compare them.
        """
        kept = {name: side for name, side in self.sides.items() if name == OURS or name in sides}
        ground = self.ground if self.ground in kept else ""
        return replace(
            self, sides=kept, ground=ground, goals=tuple(goal for goal in self.goals if goal.beside in {"", *kept})
        )


@dataclass(frozen=True)
class Spread:
    median: float
    lowest: float
    highest: float

    @classmethod
    def of(cls, values: list[float]) -> Spread:
        return cls(statistics.median(values), min(values), max(values))


@dataclass(frozen=True)
class Verdict:
    goal: Goal
    value: float
    """The median over the rounds, of the ratio, or of the figure if the goal has no other side."""

    @property
    def met(self) -> bool:
        return self.goal.met(self.value)


@dataclass(frozen=True)
class Machine:
    """The computer and the date. ``load_before`` is the one-minute load average before the first round."""

    processor: str
    cores: int
    kernel: str
    python: str
    date: str
    load_before: float

    @classmethod
    def current(cls) -> Machine:
        names = [
            line.partition(":")[2].strip()
            for line in Path("/proc/cpuinfo").read_text().splitlines()
            if line.startswith("model name")
        ]
        return cls(
            processor=names[0] if names else platform.machine(),
            cores=os.cpu_count() or 1,
            kernel=f"{platform.system()} {platform.release()}",
            python=platform.python_version(),
            date=datetime.datetime.now(datetime.UTC).isoformat(timespec="minutes"),
            load_before=round(os.getloadavg()[0], 2),
        )


@dataclass(frozen=True)
class Result:
    """All figures of a question: ``rounds[i][side][figure]`` is one figure of one side (program) in round ``i``."""

    name: str
    short: bool
    machine: Machine
    rounds: tuple[Mapping[str, Figures], ...]

    def spread(self, side: str, figure: str) -> Spread | None:
        values = [each[side][figure] for each in self.rounds if figure in each.get(side, {})]
        return Spread.of(values) if values else None

    def figures(self) -> list[str]:
        """Return the names of all figures, in the order in which they first appear. The figures of this package
        come first.
        """
        sides = [each[side] for each in self.rounds for side in sorted(each, key=lambda side: side != OURS)]
        return list(dict.fromkeys(figure for side in sides for figure in side))

    def ratio(self, figure: str, beside: str, of: str = OURS) -> Spread:
        """Return the median, lowest and highest ratio between a figure of two sides (programs). Each ratio is
        taken within one round.

        Args:
            figure: The name of the figure.
            beside: The side in the denominator; empty for the figure of ``of`` without a ratio.
            of: The side in the numerator.

        Raises:
            KeyError: A side has no such figure.
        """
        return Spread.of([each[of][figure] / (each[beside][figure] if beside else 1.0) for each in self.rounds])

    def verdicts(self, goals: tuple[Goal, ...]) -> list[Verdict]:
        return [Verdict(goal, self.ratio(goal.figure, goal.beside).median) for goal in goals]

    def write(self) -> Path:
        path = RESULTS / f"{self.name}.json"
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(asdict(self), indent=1) + "\n")
        return path

    @classmethod
    def read(cls, path: Path) -> Result:
        stored: dict[str, Any] = json.loads(path.read_text())
        return cls(stored["name"], stored["short"], Machine(**stored["machine"]), tuple(stored["rounds"]))


_beneath: Callable[[list[str]], list[str]] = list


@contextlib.contextmanager
def beneath(wrap: Callable[[list[str]], list[str]]) -> Iterator[None]:
    """Within the ``with`` block, ``wrap`` changes each command before ``beside()`` runs it, for example to run it
    under a profiler.
    """
    global _beneath
    before, _beneath = _beneath, wrap
    try:
        yield
    finally:
        _beneath = before


def beside(module: str, *args: str, python: str = sys.executable, timeout_s: float = 120) -> Figures:
    """Run ``python -m module args`` from the checkout.

    Args:
        module: The module to run.
        *args: The arguments of the module.
        python: The Python interpreter.
        timeout_s: Longest run time, in seconds.

    Returns:
        The figures, from the last JSON object that the module prints.

    Raises:
        RuntimeError: The module failed or took too long. The text contains its stderr. A peer that is not installed
            raises this, too, so that no figure is silently missing.
    """
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(HOUSE.parent), os.environ.get("PYTHONPATH", "")])
    }
    command = _beneath([python, "-m", module, *args])
    try:
        done = subprocess.run(
            command, cwd=HOUSE.parent, env=environment, capture_output=True, text=True, timeout=timeout_s
        )
    except subprocess.TimeoutExpired as late:
        raise RuntimeError(f"{' '.join(command)} took longer than {timeout_s} s:\n{late.stderr!r}") from late
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode or not lines:
        raise RuntimeError(f"{' '.join(command)} ended with code {done.returncode}:\n{done.stderr[-4000:]}")
    return {figure: float(value) for figure, value in json.loads(lines[-1]).items()}


def side_of(module: str, name: str) -> Side:
    """Return a side (a program to compare) that runs the module ``benchmarks.sides.<module>`` with the argument
    ``name``.
    """

    def side(short: bool) -> Figures:
        return beside(f"benchmarks.sides.{module}", name, *(["short"] if short else []))

    return side


def run(
    question: Question,
    rounds: int,
    short: bool,
    seed: int = 0,
    progress: Callable[[str], None] = lambda line: None,
) -> Result:
    """Run a question. Each round runs every side (program) once, in an order shuffled by ``seed``."""
    machine = Machine.current()
    order = list(question.sides)
    shuffled = random.Random(seed)
    done: list[Mapping[str, Figures]] = []
    for number in range(rounds):
        shuffled.shuffle(order)
        answered: dict[str, Figures] = {}
        for side in order:
            progress(f"{question.name} {number + 1}/{rounds} {side}")
            answered[side] = question.sides[side](short)
        done.append(answered)
    return Result(question.name, short, machine, tuple(done))


def questions() -> dict[str, Question]:
    """Return all questions of this folder by name, from the modules that have a ``QUESTION``."""
    modules = [
        importlib.import_module(f"{__package__}.{module_info.name}")
        for module_info in pkgutil.iter_modules([str(HOUSE)])
        if not module_info.ispkg and module_info.name != "__main__"
    ]
    all_questions: list[Question] = [module.QUESTION for module in modules if hasattr(module, "QUESTION")]
    return {question.name: question for question in all_questions}

"""Make each mutation in a copy of the project, and run the tests that hold its place."""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from queue import Empty, SimpleQueue

import msgspec

from .mutations import Mutation, mutations
from .page import write_page
from .places import PLACES, ROOT, Place, source_of

REASONS = Path(__file__).with_name("reasons.toml")
LEFT_OUT = shutil.ignore_patterns(".git", ".venv", ".*_cache", "build", "*.egg-info")
LONGEST_S = 900.0
"""Time limit of one call of pytest. A mutation that keeps the tests from ending counts as noticed."""


class Found(msgspec.Struct):
    """The result of a mutation.

    Attributes:
        path: The mutated file.
        key: The name of the mutation.
        line: Its line.
        by: The first test that failed; empty if the mutation survived.
        took_s: How long the tests ran, in seconds.
    """

    path: str
    key: str
    line: int
    by: str
    took_s: float


class Copy:
    """A copy of the project, in which one file at a time is mutated."""

    def __init__(self, directory: Path) -> None:
        self.root = directory / "project"
        shutil.copytree(ROOT, self.root, symlinks=True, ignore=LEFT_OUT)

    def first_failure(self, place: Place, source: str) -> str:
        """Return the first test that fails with this source; empty if all tests pass."""
        file = self.root / place.path
        before = file.read_text()
        file.write_text(source)
        try:
            return next((failed for test in place.tests if (failed := self._run(test))), "")
        finally:
            file.write_text(before)

    def _run(self, test: str) -> str:
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not long", "-p", "no:cacheprovider", test]
        theirs = {**os.environ, "PYTHONPATH": str(self.root), "PYTHONDONTWRITEBYTECODE": ""}
        try:
            done = subprocess.run(
                command, cwd=self.root, env=theirs, capture_output=True, text=True, timeout=LONGEST_S
            )
        except subprocess.TimeoutExpired:
            return f"{test}: it never ended"
        if done.returncode == 0:
            return ""
        lines = done.stdout.splitlines()
        named = (line.split()[1] for line in lines if line.startswith(("FAILED ", "ERROR ")))
        return next(named, f"{test}: pytest ended with {done.returncode}")


def wanted(only: str) -> Iterator[tuple[Place, Mutation]]:
    for place in PLACES:
        if only in place.path:
            yield from ((place, each) for each in mutations(source_of(place), place.functions))


def known(resume: Path | None) -> dict[tuple[str, str], Found]:
    if resume is None or not resume.exists():
        return {}
    found = (msgspec.json.decode(line, type=Found) for line in resume.read_bytes().splitlines())
    return {(each.path, each.key): each for each in found}


def reasons() -> dict[str, dict[str, str]]:
    """Return the reasons by which survivors are excused, by path and key."""
    return tomllib.loads(REASONS.read_text()) if REASONS.exists() else {}


def work(queue: SimpleQueue[tuple[Place, Mutation]], found: SimpleQueue[Found | BaseException]) -> None:
    try:
        with tempfile.TemporaryDirectory(prefix="mutate-") as directory:
            copy = Copy(Path(directory))
            while True:
                try:
                    place, mutation = queue.get_nowait()
                except Empty:
                    return
                began = time.monotonic()
                by = copy.first_failure(place, mutation.source)
                found.put(Found(place.path, mutation.key, mutation.line, by, round(time.monotonic() - began, 1)))
    except BaseException as failure:
        found.put(failure)


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests mutate", description=__doc__)
    parser.add_argument("--only", default="", help="part of the path of a file")
    parser.add_argument("--resume", type=Path, help="a file that keeps what was found")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--every", type=int, default=1, help="only each so-many-th mutation of a file")
    parser.add_argument("--page", type=Path, help="write the table there")
    given = parser.parse_args(arguments)
    done = known(given.resume)
    queue: SimpleQueue[tuple[Place, Mutation]] = SimpleQueue()
    results: SimpleQueue[Found | BaseException] = SimpleQueue()
    total = 0
    counts: dict[str, int] = {}
    for place, mutation in wanted(given.only):
        counts[place.path] = counts.get(place.path, -1) + 1
        if counts[place.path] % given.every == 0 and (place.path, mutation.key) not in done:
            queue.put((place, mutation))
            total += 1
    workers = [threading.Thread(target=work, args=(queue, results), daemon=True) for _ in range(given.jobs)]
    for worker in workers:
        worker.start()
    for _ in range(total):
        each = results.get()
        if isinstance(each, BaseException):
            raise each
        done[each.path, each.key] = each
        verdict = each.by or "SURVIVED"
        print(f"{each.path}:{each.line}  {each.key}\n    {verdict} ({each.took_s:g} s)", flush=True)
        if given.resume is not None:
            with given.resume.open("ab") as file:
                file.write(msgspec.json.encode(each) + b"\n")
    why = reasons()
    left = [each for each in done.values() if not each.by and each.key not in why.get(each.path, {})]
    if given.page is not None:
        write_page(given.page, list(done.values()), why)
    killed = sum(bool(each.by) for each in done.values())
    print(f"{killed} of {len(done)} were noticed, {len(left)} survived without a reason")
    return int(bool(left))

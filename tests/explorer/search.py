"""Run many seeds on all cores, ``CHUNK`` seeds in each child process.

The objects of a simulated process that was killed must never be garbage collected. Their
``finally`` blocks would run, and after a real SIGKILL no such block runs. So nothing of a run is
collected, and each child process ends by ``os._exit``.
"""

from __future__ import annotations

import gc
import os
import selectors
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import msgspec

from .invariants import Violation
from .plan import Plan, plan_of
from .run import Run

CHUNK = 20
"""Seeds per child process. Each takes 1 MB."""

_kept: list[Run] = []


class Result(NamedTuple):
    """The result of one run.

    Attributes:
        digest: Digest of the whole history.
    """

    plan: Plan
    violations: tuple[Violation, ...]
    digest: str


class Crash(Exception):
    """A child process ended without a result. This is a defect of the explorer."""


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(list[Result]).decode


def run_here(plan: Plan) -> Run:
    """Run a plan in this process, and keep the run so that it is never collected."""
    run = Run(plan)
    _kept.append(run)
    run.go()
    return run


def run_apart(plans: Iterable[Plan], jobs: int = 1) -> Iterator[Result]:
    """Run plans in child processes, ``jobs`` at a time, and yield the results as they arrive."""
    chunks = _chunks(plans)
    with selectors.DefaultSelector() as waiting:
        for chunk in chunks:
            _begin(chunk, waiting)
            if len(waiting.get_map()) >= jobs:
                yield from _finish_one(waiting)
        while waiting.get_map():
            yield from _finish_one(waiting)


def run_seeds(
    seeds: Iterable[int], robot: str, jobs: int = 1, draw: Callable[[int, str], Plan] = plan_of
) -> Iterator[Result]:
    return run_apart((draw(seed, robot) for seed in seeds), jobs)


def _chunks(plans: Iterable[Plan]) -> Iterator[list[Plan]]:
    chunk: list[Plan] = []
    for plan in plans:
        chunk.append(plan)
        if len(chunk) == CHUNK:
            yield chunk
            chunk = []
    if chunk:
        yield chunk


def _begin(chunk: list[Plan], waiting: selectors.BaseSelector) -> None:
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            gc.disable()
            # A search uses every core for hours. Other programs of this computer take precedence.
            os.nice(10)
            results = [Result(plan, run.violations, run.digest()) for plan in chunk for run in (run_here(plan),)]
            with os.fdopen(writer, "wb", closefd=False) as pipe:
                pipe.write(_encode(results))
            code = 0
        finally:
            os._exit(code)
    os.close(writer)
    waiting.register(reader, selectors.EVENT_READ, (pid, chunk, bytearray()))


def _finish_one(waiting: selectors.BaseSelector) -> list[Result]:
    """Wait until one child process has ended, and return its results."""
    while True:
        for key, _ in waiting.select():
            reader, (pid, chunk, data) = key.fd, key.data
            piece = os.read(reader, 1 << 16)
            data += piece
            if piece:
                continue
            waiting.unregister(reader)
            os.close(reader)
            _, status = os.waitpid(pid, 0)
            if status:
                raise Crash(f"one of the seeds {chunk[0].seed} to {chunk[-1].seed} ended its process: {status}")
            return _decode(bytes(data))

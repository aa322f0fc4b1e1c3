"""Runs many seeds, on all cores, each few in a process of their own.

What a simulated process held when it was killed must never be cleaned up: ``finally`` blocks would
run, which no SIGKILL lets run. So nothing of a run is collected, and the process that ran a few
ends by ``os._exit``.
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
"""Seeds a process: 1 MB each."""

_kept: list[Run] = []


class Result(NamedTuple):
    """``digest``: of the whole history."""

    plan: Plan
    violations: tuple[Violation, ...]
    digest: str


class Crash(Exception):
    """A process of the search has ended without a result: a defect of the explorer."""


_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(list[Result]).decode


def run_here(plan: Plan) -> Run:
    """Run it in this process, which keeps what is left of it."""
    run = Run(plan)
    _kept.append(run)
    run.go()
    return run


def run_apart(plans: Iterable[Plan], jobs: int = 1) -> Iterator[Result]:
    """Run them in processes forked from this one, ``jobs`` at a time; yield results as they
    come."""
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
            os.nice(10)  # a search takes every core for hours: what else runs here comes first
            results = [Result(plan, run.violations, run.digest()) for plan in chunk for run in (run_here(plan),)]
            with os.fdopen(writer, "wb", closefd=False) as pipe:
                pipe.write(_encode(results))
            code = 0
        finally:
            os._exit(code)
    os.close(writer)
    waiting.register(reader, selectors.EVENT_READ, (pid, chunk, bytearray()))


def _finish_one(waiting: selectors.BaseSelector) -> list[Result]:
    """Wait until one process has ended; what it found."""
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

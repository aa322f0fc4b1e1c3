"""``record`` and ``replay``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import msgspec
import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.shown import harmless
from strands_actors.surfaces.recording.code import build_driver, fingerprint
from strands_actors.surfaces.recording.errors import RecordingError
from strands_actors.surfaces.recording.file import Info, RecordingFile, read
from strands_actors.surfaces.recording.player import Difference, Outcome
from strands_actors.surfaces.recording.player import replay as play
from strands_actors.surfaces.recording.to_file import Summary, record_until_stopped
from strands_actors.version import __version__

from .errors import Problem

DIFFERENT = 1


def record(robot: str, out: Path, seconds: float | None, as_json: bool) -> int:
    """Record a robot into a new file, for ``seconds`` or until Ctrl-C. Return the exit code."""
    is_terminal = sys.stderr.isatty() and not as_json

    def started() -> None:
        end = "Ctrl-C ends it" if seconds is None else f"{seconds:g} s"
        print(f"recording {robot} to {out}; {end}", file=sys.stderr, flush=True)

    def progress(at_s: float, file: RecordingFile) -> None:
        if is_terminal:
            counts = file.counts
            line = f"{at_s:.0f} s, {counts['command']} commands, {counts['refusal']} refused, {counts['gap']} gaps"
            print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)

    try:
        summary = trio.run(record_until_stopped, robot, out, seconds, started, progress)
    except RecordingError as problem:
        raise Problem(f"record: {problem}") from problem
    finally:
        if is_terminal:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
    print(json.dumps(msgspec.to_builtins(summary)) if as_json else _summed_up(summary))
    return 0


def _summed_up(summary: Summary) -> str:
    gaps = "no gaps" if summary.gaps == 0 else f"{summary.gaps} GAPS"
    return (
        f"{summary.path}: {summary.seconds:.1f} s, {summary.commands} commands ({summary.refusals} refused), "
        f"{summary.observations} observations, {summary.safe} safe events, {gaps}, {summary.bytes / 1e3:.0f} kB; "
        f"{summary.ended}"
    )


def replay(path: Path, as_json: bool) -> int:
    """Make every decision of a recording again, and compare. Return 1 if a decision differs, else 0."""
    try:
        recording = read(path)
        driver = build_driver(recording.info)
        outcome = play(recording, driver)
    except RecordingError as problem:
        raise Problem(harmless(f"replay: {problem}")) from problem
    mismatch = _mismatch(recording.info, driver)
    if as_json:
        info = recording.info
        plain = {"path": str(path), "robot": info.robot, "version": info.version, "mismatch": mismatch}
        print(json.dumps(plain | msgspec.to_builtins(outcome)))
    else:
        if mismatch:
            print(harmless(f"{path}: {mismatch}"), file=sys.stderr)
        print("\n".join(map(harmless, _text(path, outcome).split("\n"))))
    return 0 if outcome.equal else DIFFERENT


def _mismatch(info: Info, driver: Driver) -> str:
    """Return a text if the recording was made with other code. Empty if the code is the same."""
    if info.version != __version__:
        return f"recorded by strands-actors {info.version}, replayed by {__version__}"
    code = fingerprint(type(driver))
    if info.code != code:
        return f"recorded by other code of strands-actors {__version__} ({info.code}), replayed by {code}"
    return ""


def _text(path: Path, outcome: Outcome) -> str:
    aside = ""
    if outcome.gaps:
        aside = f"; {outcome.gaps} gaps, {outcome.skipped} messages not compared"
    if outcome.difference is None:
        return (
            f"{path}: equal. {outcome.steps} messages, {outcome.effects} decisions, {outcome.seconds:.1f} s{aside}"
        )
    return f"{path}: DIFFERENT after {outcome.steps - 1} equal messages{aside}\n{_described(outcome.difference)}"


def _described(difference: Difference) -> str:
    lines = [f"  {difference.at_s:.3f} s: {difference.actor} takes {difference.message}"]
    for title, effects in (("recorded", difference.recorded), ("replayed", difference.replayed)):
        for effect in effects or ["nothing"]:
            lines.append(f"  {title}: {effect}")
    return "\n".join(lines)

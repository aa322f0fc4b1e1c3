"""``record --dataset``, and the commands of ``dataset``."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import msgspec
import trio
from rich.console import Console
from rich.table import Table

from strands_actors.surfaces.dataset.compact import compact as make_compact
from strands_actors.surfaces.dataset.keys import HELP, STDIN, read_keys, read_words, single_keys
from strands_actors.surfaces.dataset.repair import repair as do_repair
from strands_actors.surfaces.dataset.run import EpisodeSummary, Summary, record_episodes
from strands_actors.surfaces.dataset.session import Event, Order, Progress, give_way
from strands_actors.surfaces.dataset.show import Shown
from strands_actors.surfaces.dataset.show import show as look_at
from strands_actors.surfaces.recording.errors import RecordingError

from .errors import Problem

CLEAR = "\r\x1b[K"
BAR = 12


class Screen:
    """Lines on stderr, and below them one that changes, on a terminal."""

    def __init__(self, episodes: int | None, as_json: bool) -> None:
        self._of = "" if episodes is None else f"/{episodes}"
        self._is_live = sys.stderr.isatty() and not as_json

    def say(self, line: str) -> None:
        print(f"{CLEAR if self._is_live else ''}{line}", file=sys.stderr, flush=True)

    def tell(self, event: Event) -> None:
        match event.what:
            case "ready":
                self.say(f"recording {event.text}")
            case "started":
                self.say(f"episode {event.episode}: recording")
            case "saved":
                self.say(
                    f"episode {event.episode}: {event.frames} frames, {event.marks or 'nothing missing'}; saved"
                )
            case "discarded":
                self.say(f"episode {event.episode}: discarded")
            case _:
                self.say(event.text)

    def show(self, now: Progress) -> None:
        if self._is_live:
            print(f"{CLEAR}{line_of(now)}", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        if self._is_live:
            print(CLEAR, end="", file=sys.stderr, flush=True)


def line_of(now: Progress) -> str:
    """The line of progress."""
    left = f"{now.free_bytes / 1e9:.1f} GB left"
    of = "" if now.of is None else f"/{now.of}"
    bar = ""
    if now.of:
        full = min(BAR, BAR * now.done // now.of)
        bar = f"[{'#' * full}{'.' * (BAR - full)}] "
    done = f"{bar}{now.done}{of} saved"
    if now.state == "waiting":
        return f"{done}, {left}    {HELP}"
    late = f", {now.late} late" if now.late else ""
    return f"{done}, {now.state} {now.seconds:.0f} s, {now.fps:.0f} fps, {now.gaps} gaps{late}, {left}"


def record(order: Order, as_json: bool) -> int:
    screen = Screen(order.episodes, as_json)
    is_terminal = os.isatty(STDIN)

    async def controls(command: Callable[[str], None]) -> None:
        if is_terminal:
            await read_keys(command)
        else:
            await read_words(command, lambda: None if order.seconds is not None else command("quit"))

    async def run() -> Summary:
        return await record_episodes(order, controls, screen.tell, screen.show)

    give_way()
    try:
        with single_keys(STDIN) if is_terminal else nullcontext():
            summary = trio.run(run)
    except RecordingError as problem:
        raise Problem(f"record: {problem}") from problem
    finally:
        screen.clear()
    print(json.dumps(msgspec.to_builtins(summary)) if as_json else _summed_up(summary))
    return 0


def _summed_up(summary: Summary) -> str:
    lines = [_told(one) for one in summary.episodes]
    lines.append(
        f"{summary.dataset}: {len(summary.episodes)} episodes in {summary.seconds:.1f} s, "
        f"{summary.total_episodes} in all; {summary.ended}"
    )
    if summary.left:
        lines.append(summary.left)
    return "\n".join(lines)


def _told(one: EpisodeSummary) -> str:
    return f"  {one.episode}: {one.frames} frames, {one.seconds:.1f} s, {one.marks or 'nothing missing'}"


def show(root: Path, as_json: bool) -> int:
    try:
        shown = look_at(root)
    except RecordingError as problem:
        raise Problem(f"dataset show: {problem}") from problem
    if as_json:
        print(json.dumps(msgspec.to_builtins(shown)))
    else:
        _print(shown)
    return 0


def _print(shown: Shown) -> None:
    cameras = ", ".join(f"{name} {what}" for name, what in shown.cameras.items()) or "no cameras"
    print(f"{shown.dataset}: {shown.robot_type}, {shown.fps} fps, {len(shown.joints)} joints, {cameras}")
    print(f"{shown.total_episodes} episodes, {shown.total_frames} frames, {shown.bytes / 1e6:.1f} MB")
    if shown.episodes:
        table = Table("episode", "task", "frames", "seconds", "wrong with it", box=None, pad_edge=False)
        for one in shown.episodes:
            table.add_row(str(one.episode), one.task, str(one.frames), f"{one.seconds:.1f}", one.marks)
        Console().print(table)
    for left in shown.unfinished:
        what = left.problem or f"{left.frames} frames of {left.task!r}, written {left.seconds_since:.0f} s ago"
        print(f"not finished: {left.folder}: {what}")
    if shown.uncounted:
        print(f"not counted: {', '.join(shown.uncounted)}")
    if shown.unfinished or shown.uncounted:
        print(
            f"`strands-actors dataset repair {os.path.normpath(shown.dataset)}` makes episodes of what can be used"
        )


def repair(root: Path, drop: bool, as_json: bool) -> int:
    try:
        report = do_repair(root, drop)
    except RecordingError as problem:
        raise Problem(f"dataset repair: {problem}") from problem
    if as_json:
        print(json.dumps(msgspec.to_builtins(report)))
    else:
        for name in report.swept:
            print(f"not counted, put aside: {name}")
        for one in report.repaired:
            print(one.problem or f"episode {one.episode}: {one.frames} frames, {one.marks or 'nothing missing'}")
        for name in report.dropped:
            print(f"removed: {name}")
        print(f"{report.dataset}: {report.total_episodes} episodes")
    return 1 if any(one.problem for one in report.repaired) else 0


def compact(root: Path, out: Path, as_json: bool) -> int:
    try:
        done = make_compact(root, out)
    except RecordingError as problem:
        raise Problem(f"dataset compact: {problem}") from problem
    if as_json:
        print(json.dumps(msgspec.to_builtins(done)))
    else:
        print(f"{done.copy}: {done.episodes} episodes, {done.frames} frames in {done.files} files "
              f"instead of {done.files_before}, {done.bytes / 1e6:.1f} MB")  # fmt: skip
    return 0

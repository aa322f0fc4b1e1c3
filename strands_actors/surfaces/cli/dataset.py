"""The commands ``record --dataset`` and ``dataset ...``."""

from __future__ import annotations

import json
import os
import sys
from contextlib import nullcontext
from pathlib import Path

import msgspec
import trio
from rich.console import Console
from rich.table import Table
from rich.text import Text

from strands_actors.contract.extras import missing
from strands_actors.contract.shown import harmless
from strands_actors.surfaces.dataset.dataset import STRAYS
from strands_actors.surfaces.dataset.errors import DamagedError
from strands_actors.surfaces.dataset.keys import HELP, STDIN, read_keys, read_words, single_keys
from strands_actors.surfaces.dataset.layout import STAGING
from strands_actors.surfaces.dataset.order import Event, Order, Progress, State
from strands_actors.surfaces.dataset.repair import repair as do_repair
from strands_actors.surfaces.dataset.run import (
    Command,
    EpisodeSummary,
    Onlooker,
    Summary,
    give_way,
    record_episodes,
)
from strands_actors.surfaces.dataset.show import Shown
from strands_actors.surfaces.dataset.show import show as look_at
from strands_actors.surfaces.recording.errors import RecordingError
from strands_actors.surfaces.recording.recorder import GONE
from strands_actors.teleoperation.teleoperator import PAGES, parse_listen_address

from .errors import Problem
from .teleop import how_to_open

NOT_ACHIEVED = 1
CLEAR = "\r\x1b[K"
BAR = 12


class Screen:
    """Prints the events of a recording on stderr. On a terminal, a line below the events shows the progress."""

    def __init__(self, as_json: bool) -> None:
        self._is_live = sys.stderr.isatty() and not as_json

    def say(self, line: str) -> None:
        print(f"{CLEAR if self._is_live else ''}{line}", file=sys.stderr, flush=True)

    def tell(self, event: Event) -> None:
        self.say(event.line)

    def show(self, now: Progress) -> None:
        self.count(line_of(now))

    def count(self, line: str) -> None:
        if self._is_live:
            print(f"{CLEAR}{line}", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        if self._is_live:
            print(CLEAR, end="", file=sys.stderr, flush=True)


def line_of(now: Progress) -> str:
    """Return the line that shows the progress of a recording on a terminal."""
    bar = ""
    if now.of:
        full = min(BAR, BAR * now.done // now.of)
        bar = f"[{'#' * full}{'.' * (BAR - full)}] "
    return f"{bar}{now.line}{f'    {HELP}' if now.state == State.IDLE else ''}"


def record(order: Order, keys: str | None, as_json: bool) -> int:
    """Record a dataset until the demonstrator (the person that shows the task) ends it. Return the exit code.

    Args:
        order: The options of the recording.
        keys: The web page with the recorder's keys: ``page``, ``gamepad`` or ``phone``, and ``:ADDRESS:PORT``
            for another address than the default. None for no page.
        as_json: Print the summary as JSON.
    """
    screen, onlooker = Screen(as_json), Onlooker()
    is_terminal = os.isatty(STDIN)
    name, host, port = _page(keys)

    async def read(command: Command) -> None:
        if is_terminal:
            await read_keys(command)
        else:
            # When standard input ends, a web page or a timer may still control the recording.
            goes_on = order.seconds is not None or bool(name)
            await read_words(command, lambda: None if goes_on else command("quit"))

    async def controls(command: Command) -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(read, command)
            if name:
                from strands_actors.surfaces.dataset.page import serve_keys

                try:
                    await serve_keys(
                        order.robot, host, port, onlooker, command, lambda url: screen.say(how_to_open(name, url))
                    )
                except OSError as failure:
                    raise Problem(f"record: no page at {host}:{port}: {failure}") from failure

    def tell(event: Event) -> None:
        onlooker.add_event(event)
        screen.tell(event)

    def show(progress: Progress) -> None:
        onlooker.show(progress)
        screen.show(progress)

    async def run() -> Summary:
        return await record_episodes(order, controls, tell, show)

    give_way()
    try:
        with single_keys(STDIN) if is_terminal else nullcontext():
            summary = trio.run(run)
    except RecordingError as problem:
        raise Problem(f"record: {problem}") from problem
    finally:
        screen.clear()
    print(json.dumps(msgspec.to_builtins(summary)) if as_json else _summed_up(summary))
    return 0 if is_achieved(order, summary) else NOT_ACHIEVED


def is_achieved(order: Order, summary: Summary) -> bool:
    """Return False if the robot ended before all requested episodes were saved, or if the second place lacks an
    episode. If the user ended the recording, no more episodes are wanted."""
    has_all = order.episodes is None or len(summary.episodes) >= order.episodes
    return not summary.not_copied and (summary.ended != GONE or (has_all and not summary.remaining))


def _page(keys: str | None) -> tuple[str, str, int]:
    """Return the name, host and port of the requested web page. The name is empty if no page is requested."""
    if keys is None:
        return "", "", 0
    name, _, listen = keys.partition(":")
    if name not in PAGES:
        raise Problem(
            f"record: --keys {keys}: there is no such page. Use {', '.join(PAGES)}, or phone:ADDRESS:PORT"
        )
    if reason := missing("web", f"--keys {name}"):
        raise Problem(f"record: {reason}")
    try:
        return (name, *parse_listen_address(listen))
    except ValueError as refusal:
        raise Problem(f"record: --keys: {refusal}") from refusal


def _summed_up(summary: Summary) -> str:
    lines = [_line(episode) for episode in summary.episodes]
    lines.append(
        f"{summary.dataset}: {len(summary.episodes)} episodes in {summary.seconds:.1f} s, "
        f"{summary.total_episodes} in all; {summary.ended}"
    )
    if summary.moved_strays:
        lines.append(
            f"files of no episode, moved to {_strays_folder(summary.dataset)}: {', '.join(summary.moved_strays)}"
        )
    if summary.remaining:
        lines.append(summary.remaining)
    if summary.not_copied:
        lines.append(summary.not_copied)
    return "\n".join(lines)


def _strays_folder(dataset: str) -> Path:
    return Path(dataset) / STAGING / STRAYS


def _line(episode: EpisodeSummary) -> str:
    defects = episode.defects or "nothing missing"
    return f"  {episode.episode}: {episode.frames} frames, {episode.seconds:.1f} s, {defects}"


def show(root: Path, as_json: bool) -> int:
    """Print the contents and the defects of a dataset. Return the exit code."""
    try:
        shown = look_at(root)
    except RecordingError as problem:
        raise Problem(f"dataset show: {harmless(str(problem))}") from problem
    if as_json:
        print(json.dumps(msgspec.to_builtins(shown)))
    else:
        _print(shown)
    return 0


def _print(shown: Shown) -> None:
    cameras = ", ".join(f"{name} {description}" for name, description in shown.cameras.items()) or "no cameras"
    robot = harmless(shown.robot_type) or "no robot named"
    print(f"{shown.dataset}: {robot}, {shown.fps} fps, {len(shown.joints)} joints, {harmless(cameras)}")
    print(
        f"{shown.total_episodes} episodes, {shown.total_frames} frames, {shown.bytes / 1e6:.1f} MB, {shown.version}"
    )
    if shown.episodes:
        table = Table("episode", "task", "frames", "seconds", "wrong with it", box=None, pad_edge=False)
        for episode in shown.episodes:
            wrong = ". ".join(filter(None, (episode.damaged and f"DAMAGED: {episode.damaged}", episode.defects)))
            cells = (
                str(episode.episode),
                harmless(episode.task),
                str(episode.frames),
                f"{episode.seconds:.1f}",
                harmless(wrong),
            )
            table.add_row(*map(Text, cells))
        Console().print(table)
    if shown.damaged:
        print(f"damaged: {', '.join(map(str, shown.damaged))}. Put their files back from a copy")
    for fault in shown.faults:
        print(f"wrong: {harmless(fault)}")
    for unfinished in shown.unfinished:
        description = (
            unfinished.problem
            or f"{unfinished.frames} frames of {unfinished.task!r}, written {unfinished.seconds_since:.0f} s ago"
        )
        print(f"not finished: {unfinished.folder}: {description}")
    if shown.stray_files:
        print(f"files of no episode: {', '.join(shown.stray_files)}")
    if shown.strange:
        print(f"not of this dataset, and LeRobot would read it, move it away: {', '.join(shown.strange)}")
    if shown.unfinished or shown.stray_files:
        print(
            f"`strands-actors dataset repair {os.path.normpath(shown.dataset)}` makes episodes of what can be used"
        )


def repair(root: Path, drop: bool, as_json: bool) -> int:
    """Repair a dataset, and print the result. Return 1 if it still has defects, else 0."""
    try:
        report = do_repair(root, drop)
    except DamagedError as damage:
        return not_achieved("repair", damage)
    except (RecordingError, OSError) as problem:
        raise Problem(f"dataset repair: {harmless(str(problem))}") from problem
    if as_json:
        print(json.dumps(msgspec.to_builtins(report)))
    else:
        for name in report.moved_strays:
            print(f"files of no episode, moved to {_strays_folder(report.dataset)}: {name}")
        for repaired in report.repaired:
            print(
                repaired.problem
                or f"episode {repaired.episode}: {repaired.frames} frames, {repaired.defects or 'nothing missing'}"
            )
        for name in report.dropped:
            print(f"removed: {name}")
        for damaged in report.damaged:
            print(f"episode {damaged.episode} is damaged, and was not repaired: {harmless(damaged.problem)}")
        for fault in report.faults:
            print(f"wrong, and was not repaired: {harmless(fault)}")
        print(f"{report.dataset}: {report.total_episodes} episodes")
    return 0 if report.is_sound else NOT_ACHIEVED


def not_achieved(command: str, problem: RecordingError) -> int:
    print(f"dataset {command}: {harmless(str(problem))}", file=sys.stderr)
    return NOT_ACHIEVED

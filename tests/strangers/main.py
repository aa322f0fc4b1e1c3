"""The command ``python -m tests strangers``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from pathlib import Path

import msgspec

from . import page
from .fetch import Fetched, NotFetched, cache, fetch
from .run import run
from .table import Client, Program, clients
from .truth.compare import report
from .truth.simulators import SIMULATORS, compare
from .verdict import HONEST, Verdict, one_line


def main(arguments: Sequence[str], table: Sequence[Client] | None = None, record: Path = page.RECORD) -> int:
    """Run the command.

    Args:
        arguments: The arguments of the command line.
        table: The clients. None: those of ``clients.toml``.
        record: The file with the recorded results.

    Returns:
        0, 1 if a program was not served as its robot would serve it, or 2 for wrong arguments.
    """
    parser = argparse.ArgumentParser(prog="python -m tests strangers", description=__doc__)
    parser.add_argument(
        "--only", default="", help="only clients, programs or simulators with this text, or CLIENT/TEXT"
    )
    parser.add_argument("--truth", action="store_true", help="compare our twins with vendors' simulators instead")
    parser.add_argument("--page", action="store_true", help="record the results, and write them into the page")
    parser.add_argument("--write", action="store_true", help="only write the recorded results into the page")
    parser.add_argument("--list", action="store_true", help="list clients and programs, and run nothing")
    parser.add_argument("--keep", type=Path, help="a folder for the log and the output of each program")
    parser.add_argument(
        "--examples", action="append", default=[], metavar="CLIENT=FOLDER", help="the folder of a client's examples"
    )
    chosen = parser.parse_args(arguments)
    if wrong := [text for text in chosen.examples if "=" not in text]:
        parser.error(f"{wrong[0]!r} is not CLIENT=FOLDER")
    given = {name: Path(folder) for name, _, folder in (text.partition("=") for text in chosen.examples)}
    every = clients() if table is None else tuple(table)
    if chosen.write:
        _write_page(page.read(record))
        return 0
    if chosen.truth:
        return _compare(chosen.only, chosen.page, record)
    offered = [_with_given(one, given[one.name]) if one.name in given else one for one in every]
    picked = _picked(offered, chosen.only)
    if not picked:
        parser.error(f"no client and no program has {chosen.only!r} in its name")
    if chosen.list:
        for client in picked:
            print(f"{client.pin}: {', '.join(program.name for program in client.program)}")
        return 0
    rows = [row for client in picked for row in _run(client, given, chosen.keep)]
    print(f"\n{page.summary(rows)}\n")
    print(page.table_of(rows), end="")
    if chosen.page:
        recorded = page.read(record)
        recorded["programs"] = [*page.merged(recorded["programs"], rows, every)]
        page.write(recorded, record)
        _write_page(recorded)
    return 0 if all(row["verdict"] in HONEST for row in rows) else 1


def _picked(every: Sequence[Client], only: str) -> list[Client]:
    """Return the clients with this text in their name, and the others with their programs that have it.

    ``CLIENT/PART`` picks the programs of one client, also those without a row in the table.
    """
    picked = []
    for client in every:
        if only in client.name:
            picked.append(client)
        elif only.startswith(f"{client.name}/"):
            picked.append(_with_part(client, only.removeprefix(f"{client.name}/")))
        elif programs := tuple(program for program in client.program if only in program.name):
            picked.append(msgspec.structs.replace(client, program=programs, every=()))
    return picked


def _with_part(client: Client, part: str) -> Client:
    programs = tuple(program for program in client.program if part in program.name)
    return msgspec.structs.replace(client, program=programs, part=part)


def _with_given(client: Client, folder: Path) -> Client:
    """Return a client with all Python programs of a folder instead of its own."""
    files = sorted(path for path in folder.rglob("*.py") if path.name != "__init__.py")
    programs = tuple(Program(file=f"given:{path.relative_to(folder)}") for path in files)
    return msgspec.structs.replace(client, program=programs, every=())


def _run(client: Client, given: Mapping[str, Path], keep: Path | None) -> list[page.Row]:
    """Run all programs of a client, and return their rows."""
    today = date.today()
    print(f"{client.pin} (cache: {cache()})", file=sys.stderr, flush=True)
    try:
        fetched = fetch(client, given.get(client.name))
    except NotFetched as failure:
        why = one_line(str(failure))
        print(f"  {why}", file=sys.stderr, flush=True)
        return [
            page.row_of(client, program, program.robot or client.robot, Verdict.ABSENT, why, today)
            for program in client.program
        ]
    rows = []
    for program in (*client.program, *_without_row(client, fetched)):
        outcome = run(client, program, fetched, keep)
        verdict, reason = outcome.judged
        if verdict not in (*HONEST, Verdict.CUT_OFF):
            # The first run may have failed because the machine was busy. The second one counts.
            outcome = run(client, program, fetched, keep)
            verdict, reason = outcome.judged
        print(f"  {program.name}: {verdict} {reason} ({outcome.took_s:.1f} s)", file=sys.stderr, flush=True)
        calls, moved = outcome.seen.calls, outcome.seen.moved
        rows.append(page.row_of(client, program, outcome.robot, verdict, reason, today, calls, moved))
    return rows


def _without_row(client: Client, fetched: Fetched) -> Iterator[Program]:
    """Yield the examples that fit a pattern of the client and have no row in the table."""
    if fetched.examples is None:
        return
    named = {program.file for program in client.program}
    for pattern in client.every:
        for path in sorted(fetched.examples.glob(pattern)):
            name = str(path.relative_to(fetched.examples))
            if name not in named and client.part in name:
                yield Program(file=name)


def _compare(only: str, to_page: bool, record: Path) -> int:
    """Compare twins with simulators, and print and record what differs."""
    names = [name for name in SIMULATORS if only in name]
    results = [compare(name) for name in names]
    for result in results:
        print(report(result), end="")
    if to_page:
        recorded = page.read(record)
        old = [row for row in recorded["truth"] if row["simulator"] not in names]
        recorded["truth"] = [*old, *results]
        page.write(recorded, record)
        _write_page(recorded)
    return 0


def _write_page(recorded: Mapping[str, Sequence[page.Row]]) -> None:
    text = page.page_with(page.PAGE.read_text(), "strangers", page.text_of(recorded["programs"]))
    truth = "\n".join(report(row) for row in recorded["truth"]) or "No comparison has been recorded yet.\n"
    page.PAGE.write_text(page.page_with(text, "truth", truth))


__all__ = ["main"]

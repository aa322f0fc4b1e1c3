"""Compare the events of one session on a simulator with those on our twin. Pure functions: no I/O, no clock."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

NEAR_S = 0.15
NEAR_SHARE = 0.15
"""Two times are alike if they differ by less than ``NEAR_S`` plus this share of the longer one. Both sides are read
every 20 to 50 ms, on a computer that does other work."""
SMALL = 0.02
"""A reading below this has no sign: radians or metres."""
UNITS = {"degrees for radians": 180 / math.pi, "millimetres for metres": 1e3, "centimetres for metres": 1e2}


class Event(NamedTuple):
    """One event of a session.

    Attributes:
        name: What happened. The order of the names is compared.
        answer: The answer as a short text, such as its code and the names of its fields. Empty: no answer.
        took_s: Seconds since the request. None: not compared.
        values: Readings in radians, metres and so on, by name.
        near: How far two readings may be apart.
    """

    name: str
    answer: str = ""
    took_s: float | None = None
    values: Mapping[str, float] = {}
    near: float = 0.03


class Difference(NamedTuple):
    """What differs in one event."""

    event: str
    what: str
    simulator: str
    twin: str


def differences(simulator: Sequence[Event], twin: Sequence[Event]) -> list[Difference]:
    """Return what differs between the two runs of a session. If the order differs, only the order is returned."""
    theirs, ours = [event.name for event in simulator], [event.name for event in twin]
    if theirs != ours:
        first = next(
            (number for number, pair in enumerate(zip(theirs, ours, strict=False)) if len(set(pair)) > 1),
            min(len(theirs), len(ours)),
        )
        rest = [", ".join(map(_named, events[first : first + 3])) or "the end" for events in (simulator, twin)]
        before = theirs[first - 1] if first else "the begin"
        return [Difference(before, "order: next comes", *rest)]
    return [found for pair in zip(simulator, twin, strict=True) for found in _differ(*pair)]


def _named(event: Event) -> str:
    return f"{event.name} ({event.answer})" if event.answer else event.name


def _differ(theirs: Event, ours: Event) -> Iterator[Difference]:
    if theirs.answer != ours.answer:
        yield Difference(theirs.name, "answer", theirs.answer, ours.answer)
    if theirs.took_s is not None and ours.took_s is not None:
        apart = abs(theirs.took_s - ours.took_s)
        if apart > NEAR_S + NEAR_SHARE * max(theirs.took_s, ours.took_s):
            yield Difference(theirs.name, "time", f"{theirs.took_s:.2f} s", f"{ours.took_s:.2f} s")
    for name in sorted({*theirs.values, *ours.values}):
        first, second = theirs.values.get(name), ours.values.get(name)
        if first is None or second is None:
            given = ["not there" if value is None else f"{value:.3f}" for value in (first, second)]
            yield Difference(theirs.name, name, *given)
        elif not abs(first - second) <= theirs.near:
            yield Difference(theirs.name, _how(name, first, second), f"{first:.3f}", f"{second:.3f}")


def _how(name: str, theirs: float, ours: float) -> str:
    """Return the name of a reading, with the sign or unit that seems to be wrong."""
    if min(abs(theirs), abs(ours)) < SMALL:
        return name
    if abs(theirs + ours) < 0.1 * abs(theirs):
        return f"{name} (sign)"
    for unit, factor in UNITS.items():
        if 0.9 < abs(theirs / ours) / factor < 1.1 or 0.9 < abs(ours / theirs) / factor < 1.1:
            return f"{name} (unit: {unit}?)"
    return name


def result_of(
    name: str, title: str, robot: str, simulator: Sequence[Event], twin: Sequence[Event], day: str
) -> dict[str, Any]:
    """Return the result of a comparison, as the record keeps it."""
    return {
        "simulator": name,
        "title": title,
        "robot": robot,
        "date": day,
        "events": [event.name for event in simulator],
        "differences": [found._asdict() for found in differences(simulator, twin)],
    }


def absent_of(name: str, title: str, robot: str, reason: str, day: str) -> dict[str, Any]:
    """Return the result for a simulator that does not run on this machine."""
    return {**result_of(name, title, robot, [], [], day), "absent": reason}


def report(result: Mapping[str, Any]) -> str:
    """Return a result as text for the page."""
    events, found = result["events"], result["differences"]
    if reason := result.get("absent"):
        return f"**{result['title']}** ({result['date']}): not run on this machine: {reason}\n"
    head = f"**{result['title']}** and our twin of `{result['robot']}` ({result['date']}): {len(events)} events"
    if not found:
        return f"{head}, no difference.\n"
    note = f" {result['note']}" if result.get("note") else ""
    head = f"{head}, {len(found)} differences.{note}"
    lines = [head, "", "| event | what | simulator | twin |", "|---|---|---|---|"]
    lines += [f"| {' | '.join(str(row[key]).replace('|', '/') for key in Difference._fields)} |" for row in found]
    return "\n".join(lines) + "\n"


__all__ = ["Difference", "Event", "absent_of", "differences", "report", "result_of"]

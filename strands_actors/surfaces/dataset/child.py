"""The recorder's process of a script: commands come in on standard input, a number and a word a line;
what happens goes out on standard output, a JSON object a line, with the number of what it answers."""

from __future__ import annotations

import contextlib
import signal
import sys

import msgspec
import trio

from strands_actors.surfaces.recording.errors import RecordingError

from .keys import read_words
from .run import Command, Summary, record_episodes
from .session import Event, Order, give_way

ALIVE_S = 1.0


async def _record(order: Order) -> Summary:
    async with trio.open_nursery() as nursery:
        nursery.start_soon(_live)
        summary = await _record_episodes(order)
        nursery.cancel_scope.cancel()
    return summary


async def _live() -> None:
    """Say that we do, also while an episode is being saved."""
    while True:
        _say(Event("alive"))
        await trio.sleep(ALIVE_S)


async def _record_episodes(order: Order) -> Summary:
    async def controls(command: Command) -> None:
        def obey(line: str) -> None:
            number, _, word = line.partition(" ")
            command(word, asked=int(number))

        # An episode of a script that is gone is not finished; it can be repaired.
        await read_words(obey, lambda: signal.raise_signal(signal.SIGINT))

    return await record_episodes(order, controls, _say)


def _say(event: Event) -> None:
    with contextlib.suppress(BrokenPipeError):  # its script is gone; that ends us in a moment
        print(msgspec.json.encode(event).decode(), flush=True)


def main() -> int:
    """Entry: the order, in JSON."""
    order = msgspec.json.decode(sys.argv[1], type=Order)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever started us may have it ignored
    give_way()
    try:
        summary = trio.run(_record, order)
    except BaseExceptionGroup as group:
        return _fail(_first(group))
    except (RecordingError, OSError) as problem:
        return _fail(problem)
    _say(Event("ended", text=". ".join(filter(None, (f"{order.robot}: {summary.ended}", summary.left)))))
    return 0


def _fail(problem: BaseException) -> int:
    print(" ".join(str(problem).split()), file=sys.stderr)
    return 1


def _first(group: BaseException) -> BaseException:
    """What happened in a task comes in groups: the first in it, if it is one that a user
    understands."""
    while isinstance(group, BaseExceptionGroup):
        group = group.exceptions[0]
    if isinstance(group, RecordingError | OSError):
        return group
    raise group


if __name__ == "__main__":
    sys.exit(main())

"""The recorder process of a script (``script``).

The script writes commands to standard input. Each line has a number and a word. The recorder writes an
``Event`` as a line of JSON to standard output. An event that answers a command has the command's number.
"""

from __future__ import annotations

import contextlib
import signal
import sys

import msgspec
import trio

from strands_actors.surfaces.recording.errors import RecordingError

from .keys import read_words
from .order import Event, Order
from .run import Command, Summary, give_way, record_episodes

ALIVE_S = 1.0


async def _record(order: Order) -> Summary:
    async with trio.open_nursery() as nursery:
        nursery.start_soon(_live)
        summary = await _record_episodes(order)
        nursery.cancel_scope.cancel()
    return summary


async def _live() -> None:
    """Send the event ``alive`` each second, even while an episode is being saved."""
    while True:
        _say(Event("alive"))
        await trio.sleep(ALIVE_S)


async def _record_episodes(order: Order) -> Summary:
    async def controls(command: Command) -> None:
        def obey(line: str) -> None:
            number, _, word = line.partition(" ")
            command(word, command_number=int(number))

        # When the script has ended, stop as on Ctrl-C. The running episode stays unfinished, and can be
        # repaired.
        await read_words(obey, lambda: signal.raise_signal(signal.SIGINT))

    return await record_episodes(order, controls, _say)


def _say(event: Event) -> None:
    # The script has ended. The end of standard input then ends this process.
    with contextlib.suppress(BrokenPipeError):
        print(msgspec.json.encode(event).decode(), flush=True)


def main() -> int:
    """Run the recorder. The first argument is the ``Order``, in JSON. Return the exit code."""
    order = msgspec.json.decode(sys.argv[1], type=Order)
    # If the parent process ignores SIGINT, so does this process. Therefore set the default handler.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    give_way()
    try:
        summary = trio.run(_record, order)
    except BaseExceptionGroup as group:
        return _fail(_first(group))
    except (RecordingError, OSError) as problem:
        return _fail(problem)
    if summary.not_copied:
        _say(Event("not_copied", text=summary.not_copied))
    _say(Event("ended", text=". ".join(filter(None, (f"{order.robot}: {summary.ended}", summary.remaining)))))
    return 0


def _fail(problem: BaseException) -> int:
    print(" ".join(str(problem).split()), file=sys.stderr)
    return 1


def _first(group: BaseException) -> BaseException:
    """Return the first exception of a group if its message is written for users. Otherwise raise the
    exception."""
    while isinstance(group, BaseExceptionGroup):
        group = group.exceptions[0]
    if isinstance(group, RecordingError | OSError):
        return group
    raise group


if __name__ == "__main__":
    sys.exit(main())

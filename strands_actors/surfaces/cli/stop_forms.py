"""Recognise a stop command that was typed in another form in a hurry, and correct it."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from strands_actors.contract.stop_words import asks_for_stop, names_estop

EVERY = ("all", "everything")


def spelled(arguments: Sequence[str], commands: Collection[str]) -> list[str]:
    """Return the arguments of the command line. If they mean a stop, they become the command ``stop`` or
    ``estop``.

    Examples are ``STOP so101``, ``so101 stop``, ``send so101 stop``, ``e-stop``, ``stop all``.

    Args:
        arguments: The arguments of the command line.
        commands: The names of the commands.
    """
    match [*arguments]:
        case [("stop" | "estop") as name, *rest]:
            return [name, *_rest(rest)]
        case [str() as first, *rest] if first not in commands and asks_for_stop(first):
            every = any(word in first.lower() for word in EVERY)
            return [_name(first), *(["--all"] if every else []), *_rest(rest)]
        case [str() as robot, str() as second, *rest] if robot not in commands and asks_for_stop(second):
            return [_name(second), *_rest([robot, *rest])]
        case ["send", str() as robot, str() as second, *rest] if asks_for_stop(second):
            return [_name(second), *_rest([robot, *rest])]
    return [*arguments]


def _name(text: str) -> str:
    return "estop" if names_estop(text) else "stop"


def _rest(rest: Sequence[str]) -> list[str]:
    return ["--all" if text.lower() in EVERY else text for text in rest]

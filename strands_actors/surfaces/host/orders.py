"""Send an order to the host of this user, from another process."""

from __future__ import annotations

import contextlib
import socket

import msgspec

from .messages import LINE_BYTES, HostStatus, Order, Verb, socket_path

ANSWER_S = {Verb.STATUS: 10.0, Verb.RELOAD: 180.0, Verb.DOWN: 180.0}
"""Longest time for an answer. A reload and the end of the host wait until robots are safe: an arm is lowered."""


class NoHost(Exception):
    """No host of this user answers."""


def order(verb: Verb) -> HostStatus:
    """Send an order, and return the host's answer.

    Raises:
        NoHost: No host runs, or it does not answer.
    """
    path = socket_path()
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as connection:
        connection.settimeout(ANSWER_S[verb])
        try:
            connection.connect(str(path))
            connection.sendall(msgspec.json.encode(Order(verb)) + b"\n")
            with connection.makefile("rb") as answers:
                line = answers.readline(LINE_BYTES)
        except (FileNotFoundError, ConnectionRefusedError):
            raise NoHost("no host of this user runs. Start one: strands-actors up FILE") from None
        except OSError as error:
            raise NoHost(f"the host at {path} does not answer ({error}). It may be suspended") from None
    try:
        return msgspec.json.decode(line, type=HostStatus)
    except msgspec.MsgspecError:
        raise NoHost(f"the host at {path} ended before it answered") from None

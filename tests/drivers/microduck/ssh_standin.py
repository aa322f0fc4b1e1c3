"""Stand-in for ``ssh -N -L``: it listens here and forwards each connection to the address in
``SSH_STANDIN_ROBOTD`` or ``SSH_STANDIN_TOFD``. It writes its arguments and its parent to ``SSH_STANDIN_LOG``."""

from __future__ import annotations

import functools
import json
import os
import sys

import trio


async def hand_on(source: trio.abc.ReceiveStream, target: trio.abc.SendStream) -> None:
    try:
        async for data in source:
            await target.send_all(data)
    except trio.BrokenResourceError:
        pass
    await target.aclose()


async def relay(there: str, client: trio.SocketStream) -> None:
    daemon = await trio.open_unix_socket(there)
    async with client, daemon, trio.open_nursery() as nursery:
        nursery.start_soon(hand_on, client, daemon)
        nursery.start_soon(hand_on, daemon, client)


async def serve(words: list[str]) -> None:
    named = {"/run/robotd.sock": "SSH_STANDIN_ROBOTD", "/run/tofd/tof.sock": "SSH_STANDIN_TOFD"}
    async with trio.open_nursery() as nursery:
        for forward in (words[at + 1] for at, word in enumerate(words) if word == "-L"):
            here, _, there = forward.partition(":")
            listener = trio.socket.socket(trio.socket.AF_UNIX)
            await listener.bind(here)
            listener.listen()
            handler = functools.partial(relay, os.environ.get(named[there], "/nowhere"))
            nursery.start_soon(trio.serve_listeners, handler, [trio.SocketListener(listener)])


def main(words: list[str]) -> None:
    with open(os.environ["SSH_STANDIN_LOG"], "a") as log:
        log.write(json.dumps({"pid": os.getpid(), "parent": os.getppid(), "words": words}) + "\n")
    if "refused.example" in words[-1]:
        print("Permission denied (publickey).", file=sys.stderr)
        raise SystemExit(255)
    trio.run(serve, words)


main(sys.argv[1:])

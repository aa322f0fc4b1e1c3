"""In the place of ``ssh -N -L``: sockets here, each connection handed on to the twin that
``SSH_STANDIN_ROBOTD`` names. What it was called with, and by whom, goes to ``SSH_STANDIN_LOG``."""

from __future__ import annotations

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


async def relay(client: trio.SocketStream) -> None:
    robotd = await trio.open_unix_socket(os.environ["SSH_STANDIN_ROBOTD"])
    async with client, robotd, trio.open_nursery() as nursery:
        nursery.start_soon(hand_on, client, robotd)
        nursery.start_soon(hand_on, robotd, client)


async def serve(words: list[str]) -> None:
    listeners = []
    for forward in (words[at + 1] for at, word in enumerate(words) if word == "-L"):
        here, _, there = forward.partition(":")
        if there != "/run/robotd.sock":
            continue
        listener = trio.socket.socket(trio.socket.AF_UNIX)
        await listener.bind(here)
        listener.listen()
        listeners.append(trio.SocketListener(listener))
    await trio.serve_listeners(relay, listeners)


def main(words: list[str]) -> None:
    with open(os.environ["SSH_STANDIN_LOG"], "a") as log:
        log.write(json.dumps({"pid": os.getpid(), "parent": os.getppid(), "words": words}) + "\n")
    if "refused.example" in words[-1]:
        print("Permission denied (publickey).", file=sys.stderr)
        raise SystemExit(255)
    trio.run(serve, words)


main(sys.argv[1:])

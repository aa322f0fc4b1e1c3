"""Entry functions of ``process.start`` that the tests of the kernel run in child processes."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any

import trio

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node
from strands_actors.kernel.processes.process import start

ECHO = "strands/child/actor/echo"


class Ask(Message, frozen=True):
    text: str


class Give(Message, frozen=True):
    """Ask the echo to write ``text`` to the descriptors."""

    descriptors: tuple[int, ...]
    text: str


class Told(Message, frozen=True):
    text: str
    pid: int


class Echo(Actor):
    def receive(self, message: Ask | Give) -> Told:
        if isinstance(message, Give):
            for fd in message.descriptors:
                os.write(fd, message.text.encode())
                os.close(fd)
        return Told(message.text, os.getpid())


async def _echo(sock: socket.socket) -> None:
    node = Node("child", MonotonicClock())
    link = Link(node, sock)
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(node.cell("child/actor/echo", Echo).run)
        await link.run()
        nursery.cancel_scope.cancel()


def echo(args: dict[str, Any], sock: socket.socket) -> None:
    """Answer until the parent has ended."""
    trio.run(_echo, sock)


async def _exits(code: int) -> None:
    async with trio.open_nursery() as outer, trio.open_nursery() as inner:
        outer.start_soon(trio.sleep_forever)
        inner.start_soon(sys.exit, code)


async def _raises() -> None:
    async with trio.open_nursery() as nursery:
        nursery.start_soon(_fails)


async def _fails() -> None:
    try:
        {}["a"]
    except KeyError:
        raise RuntimeError("a fault of the child") from None


def ends(args: dict[str, Any], sock: socket.socket) -> None:
    """End in the way that ``args`` gives, although a thread still runs and a file cannot be flushed."""
    threading.Thread(target=time.sleep, args=(1000,)).start()
    if args.get("deaf"):
        sys.stderr = open(os.open("/dev/full", os.O_WRONLY), "w")  # noqa: SIM115
        print("never written", file=sys.stderr, end="")
    match args["how"]:
        case "return":
            return
        case "raise":
            raise RuntimeError("a fault of the child")
        case "exit":
            sys.exit(args["code"])
        case "exit in a task":
            trio.run(_exits, args["code"])
        case "raise in a task":
            trio.run(_raises)


def prints(args: dict[str, Any], sock: socket.socket) -> None:
    """Print from Python, and directly to the descriptor as a C library does. Then kill this process."""
    print("by Python")
    os.write(1, b"by C\n")
    os.kill(os.getpid(), signal.SIGKILL)


def speaks(args: dict[str, Any], sock: socket.socket) -> None:
    """Send the received arguments and the inherited descriptors over the raw socket."""
    inherited = [os.readlink(f"/proc/self/fd/{fd}") for fd in args["fds"]]
    text = f"{args['word']} {os.getpgid(0) == os.getpid()} {len(inherited)} {args['nested']['a']}"
    sock.sendall(text.encode())


def wait(args: dict[str, Any], sock: socket.socket) -> None:
    """Wait until it is killed."""
    time.sleep(1000)


def touch(args: dict[str, Any], sock: socket.socket) -> None:
    """Create the file ``path``, as a proof that this ran."""
    Path(args["path"]).touch()


def family(args: dict[str, Any], sock: socket.socket) -> None:
    """Start an echo as a child of this process, send its pid, and wait."""
    signal.signal(signal.SIGINT, lambda *_: sock.sendall(b"interrupted"))
    child = start(f"{__name__}:echo", {})
    sock.sendall(str(child.pid).encode())
    time.sleep(1000)
    child.kill()


def tell_scheduling(args: dict[str, Any], sock: socket.socket) -> None:
    """Send this process's scheduling policy."""
    sock.sendall(str(os.sched_getscheduler(0)).encode())


def write(args: dict[str, Any], sock: socket.socket) -> None:
    """Write to the received descriptor after the parent has closed its own copy."""
    time.sleep(0.1)
    os.write(args["descriptors"][0], args["text"].encode())

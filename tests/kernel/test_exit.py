"""SAF-015: a process that ends for any reason has ended at once. This library delays neither its end nor
the end of its leases.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import trio

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.frames import Down
from strands_actors.kernel.node import Node
from strands_actors.kernel.processes.process import wait_for_end_of

from .joints import reachable
from .kernel import real_time

GONE_WITHIN_S = 1.0
"""The published bound is 0.1 s. This one is longer, because the machine may be busy."""

ADDRESS = "strands/script/actor/holder"

SCRIPT = """
import os, signal, sys, time
import trio
from strands_actors.caller.session.portal import portal
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.messages import Message
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.node import Node
from strands_actors.kernel.clock import MonotonicClock
from tests.kernel.kernel import Alarm

class Holder(Actor):
    async def started(self):
        self.context.every(0.01, Alarm)  # the loop is never idle

    def receive(self, message: Alarm) -> Alarm:
        return message

signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may ignore it
shared = portal()

async def begin():
    cell = shared.node.cell("script/actor/holder", Holder)
    await shared.nursery.start(cell.run)
    # A second session, with a node that watches the first: subscribers of every kind.
    mesh = await ZenohMesh.open([], [shared.entrance.endpoint], secret=shared.entrance.secret)
    node = Node("second", MonotonicClock())
    mesh.attach(node)
    await shared.nursery.start(mesh.run)
    node.watch(cell.address, "strands/script/actor/nobody")
    shared.nursery.start_soon(talk, node.ref(cell.address))

async def talk(ref):
    while True:  # there is always a message under way: what ends must end all the same
        for _ in range(20):
            ref.tell(Alarm(1))
        await trio.sleep(0.0005)

shared.call(begin)

def ending():
    print("ending", time.monotonic_ns(), flush=True)

print("ready", *shared.entrance, flush=True)
sys.stdin.readline()
"""

ENDS = {
    "end of the script": "ending()",
    "exception": "ending(); raise RuntimeError('a fault of the script')",
    "sys.exit": "ending(); sys.exit(3)",
    "exception in a thread's future": "ending(); portal().call(trio.sleep, 'never')",
    "SIGTERM": "ending(); time.sleep(1000)",
    "SIGINT": "ending(); time.sleep(1000)",
    "SIGTERM in a call": "ending(); portal().call(trio.sleep_forever)",
    "SIGINT in a call": "ending(); portal().call(trio.sleep_forever)",
    "SIGKILL": "ending(); time.sleep(1000)",
    "SIGHUP": "ending(); time.sleep(1000)",
}
CODES = {"end of the script": 0, "exception": 1, "sys.exit": 3, "exception in a thread's future": 1}


class Watcher(Actor):
    def __init__(self) -> None:
        self.downs: list[Down] = []
        self.received = trio.Event()

    async def started(self) -> None:
        self.context.watch(ADDRESS)

    def receive(self, message: Down) -> None:
        self.downs.append(message)
        self.received.set()


def run_script(path: Path, ending: str) -> subprocess.Popen[str]:
    path.write_text(f"{SCRIPT}{ending}\n")
    return subprocess.Popen(
        [sys.executable, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )


async def end(process: subprocess.Popen[str], sig: signal.Signals) -> float:
    """Send the signal, and return the seconds until the process has ended.

    An interrupt shortly before the interpreter begins to wait does not end that wait. Then the signal is
    sent again, as a user would do at a terminal.
    """
    while True:
        sent_ns = time.monotonic_ns()
        process.send_signal(sig)
        with trio.move_on_after(2 * GONE_WITHIN_S if sig == signal.SIGINT else float("inf")) as scope:
            await wait_for_end_of(process.pid)
        if not scope.cancelled_caught:
            return (time.monotonic_ns() - sent_ns) / 1e9


@pytest.mark.quick_cases(5)
@pytest.mark.parametrize("how", ENDS)
@real_time
async def test_a_process_that_ends_takes_its_actors_with_it(how: str, tmp_path: Path) -> None:
    process = run_script(tmp_path / "script.py", ENDS[how])
    assert process.stdin is not None and process.stdout is not None
    try:
        _, endpoint, secret = (await trio.to_thread.run_sync(process.stdout.readline)).split()
        mesh = await ZenohMesh.open([], [endpoint], secret=secret)
        node = Node("outside", MonotonicClock())
        mesh.attach(node)
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            await nursery.start(mesh.run)
            await reachable(node, ADDRESS)
            watcher = Watcher()
            await nursery.start(node.cell("outside/actor/watcher", lambda: watcher).run)
            process.stdin.write("\n")
            process.stdin.flush()
            _, ended_ns = (await trio.to_thread.run_sync(process.stdout.readline)).split()
            with trio.fail_after(20):
                if how.startswith("SIG"):
                    assert watcher.downs == []
                    gone_s = await end(process, getattr(signal, how.split()[0]))
                else:
                    await wait_for_end_of(process.pid)
                    gone_s = (time.monotonic_ns() - int(ended_ns)) / 1e9
            with trio.fail_after(20):
                await watcher.received.wait()
            assert [down.address for down in watcher.downs] == [ADDRESS]
            assert watcher.downs[0].reason in ("stopped", "unreachable")
            nursery.cancel_scope.cancel()
        await trio.to_thread.run_sync(mesh.close)
    finally:
        process.kill()
        errors = process.communicate()[1]
    print(f"{how}: gone {gone_s * 1000:.1f} ms after its end")
    assert gone_s < GONE_WITHIN_S, errors
    number = getattr(signal, how.split()[0], None) if how.startswith("SIG") else None
    assert process.returncode == (CODES[how] if number is None else -number), errors
    # A script prints the same as without this library.
    assert ("RuntimeError: a fault of the script" in errors) is (how == "exception")
    assert (errors == "") is (how in ("end of the script", "sys.exit") or how.startswith(("SIGT", "SIGK", "SIGH")))

"""``echo`` and ``hz``: print the samples that robots publish, and their rates."""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import trio
import zenoh

from strands_actors.kernel.channels.pubsub import Received, Stamp
from strands_actors.kernel.channels.zenoh_session import short
from strands_actors.supervisors.mesh.schemas import TELEMETRY, key
from strands_actors.surfaces.mesh.client import MeshClient, open_mesh

from .errors import Problem
from .orders import configuration

WINDOW_S = 1.0
SILENT_S = 3.0
"""After so long without a sample, in seconds, ``echo`` prints a notice. The slowest telemetry has a period of
two seconds."""
LOOK_S = 0.1


def echo(robot_or_key: str, mesh: Path | None, as_json: bool, count: int | None, timeout_s: float | None) -> None:
    """Print the samples that robots publish.

    Args:
        robot_or_key: A robot's name, or a zenoh key such as ``strands/*/state``.
        mesh: A TOML file with the endpoints of robots on other hosts.
        as_json: Print JSON lines.
        count: End after so many samples; None for no limit.
        timeout_s: Longest time without a sample, in seconds. None: print a notice, and keep waiting.

    Raises:
        Problem: No sample came for ``timeout_s``.
    """
    trio.run(_echo, robot_or_key, mesh, as_json, count, timeout_s)


def hz(robot_or_key: str, mesh: Path | None, as_json: bool, seconds: float | None) -> None:
    """Print the rate of each topic, once after ``seconds``. If ``seconds`` is None, print it every second."""
    trio.run(_hz, robot_or_key, mesh, as_json, seconds)


async def _echo(
    robot_or_key: str, mesh: Path | None, as_json: bool, count: int | None, timeout_s: float | None
) -> None:
    show = print_json if as_json else print_line
    received_count, last_s = 0, time.monotonic()
    done = trio.Event()

    def on_sample(received: Received) -> None:
        nonlocal received_count, last_s
        if done.is_set():
            return
        show(received)
        received_count, last_s = received_count + 1, time.monotonic()
        if received_count == count:
            done.set()

    async with open_mesh(configuration(mesh)) as client:
        await _subscribe(client, robot_or_key, on_sample)
        is_announced = False
        while not done.is_set():
            with trio.move_on_after(LOOK_S):
                await done.wait()
            silent_s = time.monotonic() - last_s
            if timeout_s is not None and silent_s >= timeout_s and not done.is_set():
                raise Problem(f"no sample of {robot_or_key} arrived for {timeout_s:g} s. {_robots_on_mesh(client)}")
            if not (received_count or is_announced) and silent_s >= SILENT_S:
                is_announced = True
                print(
                    f"no sample of {robot_or_key} has arrived yet. Still waiting, "
                    f"Ctrl-C ends this. {_robots_on_mesh(client)}",
                    file=sys.stderr,
                )


def _robots_on_mesh(client: MeshClient) -> str:
    return f"robots on the mesh: {', '.join(client.robots) or 'none'}"


async def _hz(robot_or_key: str, mesh: Path | None, as_json: bool, seconds: float | None) -> None:
    times: dict[str, list[float]] = {}

    def on_sample(received: Received) -> None:
        times.setdefault(received.key, []).append(time.monotonic())

    async with open_mesh(configuration(mesh)) as client:
        await _subscribe(client, robot_or_key, on_sample)
        began = time.monotonic()
        while True:
            await trio.sleep(seconds or WINDOW_S)
            rates = [rate(name, stamps, time.monotonic() - began) for name, stamps in sorted(times.items())]
            if as_json:
                print(json.dumps({"topics": rates}), flush=True)
            else:
                print("\n".join(map(_line, rates)) or "nothing was published", flush=True)
            if seconds is not None:
                return


def rate(name: str, stamps: list[float], seconds: float) -> dict[str, Any]:
    """Return the rate of one topic, from the times between its samples.

    Args:
        name: The key of the topic.
        stamps: The time at which each sample arrived, in seconds.
        seconds: How long samples were received. With a single sample, the rate is computed from this time.
    """
    gaps = [after - before for before, after in itertools.pairwise(stamps)]
    return {
        "key": name,
        "hz": round(len(gaps) / sum(gaps), 2) if gaps and sum(gaps) else round(len(stamps) / seconds, 2),
        "samples": len(stamps),
        "longest_s": round(max(gaps), 4) if gaps else None,
    }


def _line(rate: dict[str, Any]) -> str:
    longest = "" if rate["longest_s"] is None else f"  longest gap {1e3 * rate['longest_s']:.0f} ms"
    return f"{rate['key']:<40} {rate['hz']:7.2f} Hz  {rate['samples']} samples{longest}"


async def _subscribe(client: MeshClient, robot_or_key: str, on_sample: Callable[[Received], None]) -> None:
    """Subscribe to all telemetry of a robot, or to a key with wildcards."""
    if "/" in robot_or_key:
        try:
            keys = [str(zenoh.KeyExpr(robot_or_key))]
        except zenoh.ZError as error:
            like = "give a key such as strands/so101/state, or strands/**"
            raise Problem(f"{robot_or_key!r} is not a valid key: {short(error)}. {like}") from None
    else:
        await client.settle()
        if not client.is_there(robot_or_key):
            names = ", ".join(client.robots) or "none"
            raise Problem(
                f"no robot {robot_or_key!r} is on the mesh. Use one of {names}, or a key such as strands/**"
            )
        keys = [key(robot_or_key, topic) for topic in TELEMETRY]
    for each in keys:
        client.subscribe(each, on_sample)


def print_line(received: Received) -> None:
    print(f"{received.key}  {_text(received.payload)}", flush=True)


def print_json(received: Received) -> None:
    stamp = _stamp(received.attachment)
    try:
        value: object = msgspec.json.decode(received.payload)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        value = None
    sample = {
        "key": received.key,
        "encoding": received.encoding,
        "seq": None if stamp is None else stamp.seq,
        "time_ns": None if stamp is None else stamp.time_ns,
        "value": value,
        "bytes": len(received.payload),
    }
    print(msgspec.json.encode(sample).decode(), flush=True)


def _text(payload: bytes) -> str:
    try:
        text = payload.decode()
    except UnicodeDecodeError:
        text = ""
    return text if text.isprintable() and text else f"<{len(payload)} bytes>"


def _stamp(attachment: bytes | None) -> Stamp | None:
    if attachment is None:
        return None
    try:
        return msgspec.json.decode(attachment, type=Stamp)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return None

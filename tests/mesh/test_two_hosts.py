"""A handle on one host drives a robot on another over a simulated cable."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import trio

from strands_actors import Robot
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.mesh import MeshConfig, control, open_mesh
from strands_actors.surfaces.mesh.keys import make
from strands_actors.surfaces.mesh.remote import RemoteRobot
from strands_actors.testing import Twin
from tests.ports import free_port

from .proxy import Cable
from .world import code, run, tls, until

TTL_S = 0.2
PERIOD_S = 0.02
"""Tolerance on the lifetime, for a busy machine. The measured bound is 0.1 s."""


async def stream(arm: RemoteRobot, stop: trio.Event) -> None:
    """Move the arm back and forth, as a policy on another host would."""
    start = (await observed(arm))["shoulder_pan"]
    for step in range(10_000):
        if stop.is_set():
            return
        with trio.move_on_after(0.1):
            await arm.send_action({"shoulder_pan": start + 0.4 * (step % 40)}, ttl_s=TTL_S)
        await trio.sleep(PERIOD_S)


async def observed(arm: RemoteRobot) -> dict[str, float]:
    answer = await arm.observe()
    assert not isinstance(answer, Refused), answer
    joints: dict[str, float] = answer["joints"]
    return joints


@pytest.mark.long
def test_saf_001_a_cut_cable_is_safe_within_the_lifetime_and_moves_nothing_when_it_heals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_dir: Path
) -> None:
    keys = tmp_path / "keys"
    make(keys, robots=["so101"])
    port = free_port()
    with Twin("so101", tmp_path) as twin, Cable(port) as cable:
        here = MeshConfig(listen=f"tls/127.0.0.1:{port}", tls=tls(keys, "so101"))
        robot = Robot("so101", mode="real", port=twin.port, mesh=here)
        try:
            assert robot.connect_eagerly() is None
            assert robot.release()["status"] == "success"
            elsewhere = run_dir / "elsewhere"
            elsewhere.mkdir(mode=0o700)
            monkeypatch.setenv("STRANDS_ACTORS_RUN", str(elsewhere))
            there = MeshConfig(connect=f"tls/localhost:{cable.port}", tls=tls(keys, "operator"))

            async def test() -> None:
                async with open_mesh(there) as client:
                    await client.settle(5.0)
                    async with control(client, "so101") as arm, trio.open_nursery() as nursery:
                        enough = trio.Event()
                        nursery.start_soon(stream, arm, enough)
                        await until(lambda: len(twin.log.host("setpoint")) > 20, "it moves")
                        cut_ns = time.monotonic_ns()
                        cable.cut()
                        safe = await until(lambda: twin.log.first_safe(cut_ns), "a safe frame")
                        took_s = (safe.t_ns - cut_ns) / 1e9
                        print(f"safe {1e3 * took_s:.0f} ms after the cut, with a lifetime of {1e3 * TTL_S:.0f} ms")
                        await trio.sleep(1.5)  # longer than the mesh needs to detect the lost link
                        cable.heal()
                        healed = time.monotonic()
                        while isinstance(await arm.status(), Refused):
                            assert time.monotonic() < healed + 20
                        assert twin.log.setpoints_after_safe(cut_ns) == 0
                        refused = await arm.acquire()
                        assert refused is not None and code(refused) == "holding"
                        enough.set()
                        assert await arm.resume() is None
                        now = (await observed(arm))["shoulder_pan"]
                        moved = await arm.send_action({"shoulder_pan": now + 1.0}, ttl_s=TTL_S)
                        assert not isinstance(moved, Refused), moved

            run(test)
        finally:
            robot.cleanup()

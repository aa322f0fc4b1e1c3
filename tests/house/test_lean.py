"""Root, wire and standby load no numpy, no mujoco and no screen, and take less than 60 MB each. An import of the
package is small, too."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.caller.session.portal import portal
from strands_actors.kernel.messages import Message
from strands_actors.supervisors.root.messages import Describe, TreeReport
from strands_actors.supervisors.root.process import Root
from tests.forked import execute_what_is_started_here

HEAVY = ("numpy", "mujoco", "rich", "typer", "matplotlib", "textual", "mcap", "zstandard")
MAX_MB = 60.0

IMPORT = {
    "root": "import strands_actors.supervisors.root.process",
    "wire": "import strands_actors.supervisors.wire.group",
    "standby": "import strands_actors.supervisors.standby.process",
    "driver": """
from strands_actors.drivers import get_native_driver_class
from strands_actors.kernel.clock import MonotonicClock
driver_class = get_native_driver_class("so101")
driver = driver_class("so101", "/dev/null", driver_class.resolve("so101", {}))
driver.open_wire(MonotonicClock())
""",
    "legs": """
from strands_actors.drivers import get_native_driver_class
from strands_actors.kernel.clock import MonotonicClock
driver_class = get_native_driver_class("unitree_g1")
driver = driver_class("unitree_g1", "127.0.0.1", driver_class.resolve("unitree_g1", {}))
driver.open_wire(MonotonicClock())
driver.stop_channel((), MonotonicClock())
""",
}


@pytest.mark.parametrize("what", IMPORT)
def test_a_fresh_process_loads_nothing_heavy(what: str) -> None:
    script = f"{IMPORT[what]}\nimport sys\nprint(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert "strands_actors" in loaded
    assert [name for name in HEAVY if name in loaded] == []


SPARED = ("asyncio", "importlib.metadata", "numpy", "mujoco", "strands_actors.supervisors.root.process")
"""Modules that a script loads only when it needs them, not at its import of the package."""


def test_importing_the_package_loads_only_modules_that_every_robot_needs() -> None:
    script = "from strands_actors import Robot, open_robot\nimport sys\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert "strands_actors.caller.handle.robot" in loaded
    assert [name for name in SPARED if name in loaded] == []


def resident_mb(pid: int) -> float:
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise AssertionError(f"process {pid} has no memory")


def shared_objects(pid: int) -> set[str]:
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return {parts[5] for parts in (line.split(maxsplit=5) for line in lines) if len(parts) == 6}


def test_the_processes_of_a_live_robot_are_small(monkeypatch: pytest.MonkeyPatch) -> None:
    execute_what_is_started_here(monkeypatch)

    async def describe() -> Message | None:
        return await portal().node.ref("strands/so101/actor/root", Root).ask(Describe(), 5.0)

    with Robot("so101", mode="real", transport="twin") as robot:
        assert robot.send_action({"shoulder_pan": 5.0})["status"] == "success"
        report = portal().call(describe)
        assert isinstance(report, TreeReport)
        pids = {process.role: process.pid for process in report.processes}
        figures = {role: resident_mb(pids[role]) for role in ("root", "wire", "standby")}
        mapped = {role: shared_objects(pids[role]) for role in figures}
        # The twin loads the physics, so this search finds such a library.
        assert any("mujoco" in path for path in shared_objects(pids["twin"]))
    print(", ".join(f"{role}: {figure:.1f} MB" for role, figure in figures.items()))
    assert all(any("zenoh" in path for path in mapped[role]) for role in ("root", "wire"))
    for role, figure in figures.items():
        assert figure < MAX_MB, role
        assert [path for path in mapped[role] for name in HEAVY if f"/{name}" in path] == []

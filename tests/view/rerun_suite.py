"""A recording of ``view --rerun --save FILE`` is read back by Rerun's own reader: ``python -m tests rerun``.

The ordinary tests do not load this suite, because Rerun takes half a gigabyte. It needs ``pip install
'strands-actors[rerun]'``.
"""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader

from tests.cli.command import Command, RobotProcess


def columns_of(file: Path) -> dict[str, list[Any]]:
    """Return all values of a recording, by entity and component."""
    columns: dict[str, list[Any]] = {}
    for chunk in RrdReader(str(file)).stream():
        batch = chunk.to_record_batch()
        for name in filter(lambda name: ":" in name, batch.schema.names):
            columns.setdefault(f"{chunk.entity_path}:{name}", []).extend(batch.column(name).to_pylist())
    return columns


def test_a_recording_has_joints_frames_meshes_and_a_stop(cli: Command, robot: RobotProcess, tmp_path: Path) -> None:
    file = tmp_path / "run.rrd"
    with cli.start("view", "so101", "--rerun", "--save", str(file), "--json") as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline()) == {"robot": "so101", "rerun": str(file)}
        assert robot.call("move_to", {"shoulder_pan": 30.0}, 1.5)["status"] == "success"
        assert cli.run("estop", "so101").returncode == 0
        robot.call("get_status")
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    columns = columns_of(file)
    (measured,) = (values for name, values in columns.items() if name.startswith("/joints/shoulder_pan/measured:S"))
    assert min(value[0] for value in measured if value) < 5 and max(value[0] for value in measured if value) > 25
    entities = {name.partition(":")[0] for name in columns}
    assert {"/world/base/shoulder/upper_arm", "/joints/gripper/commanded", "/events/stop"} <= entities
    assert any(name.startswith("/world/base/shoulder/mesh") for name in entities)
    texts = [value for name, values in columns.items() if name.startswith("/events/stop:T") for value in values]
    assert any("limp confirmed" in str(text) for text in texts)

    refused = cli.run("view", "so101", "--rerun", "--save", str(file))
    assert refused.returncode == 2 and "exists already" in refused.stderr

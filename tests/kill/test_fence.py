"""SAF-002: a frozen wire process that is let go again finds itself dead."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.testing import WireLog


def test_saf_002_a_frozen_wire_is_fenced_before_the_root_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The target is latched and its caller lives on: without the fence, the wire would re-send it."""
    log = WireLog(tmp_path / "wire.ndjson")
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(log.path))
    with Robot("so101", mode="real", transport="twin") as arm:
        assert arm.send_action({"shoulder_pan": 10.0})["status"] == "success"
        tree = arm.tree()
        assert tree is not None
        wire = next(process["pid"] for process in tree["processes"] if process["role"] == "wire")
        frozen_ns = time.monotonic_ns()
        os.kill(wire, signal.SIGSTOP)
        deadline_s = time.monotonic() + 5.0
        while log.first_safe(frozen_ns) is None:
            assert time.monotonic() < deadline_s, "the wire was not made safe"
            time.sleep(0.01)
        with contextlib.suppress(ProcessLookupError):
            os.kill(wire, signal.SIGCONT)
        time.sleep(0.5)  # what must not happen has no event to wait for
        assert log.setpoints_after_safe(frozen_ns) == 0
        assert not Path(f"/proc/{wire}").exists()

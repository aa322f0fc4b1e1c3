"""Test that the vendor's unmodified client accepts the twin as a robot."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from strands_actors.testing import Twin


def test_the_vendors_client_drives_the_twin(tmp_path: Path) -> None:
    with Twin("spot", tmp_path) as twin:
        done = subprocess.run(
            [sys.executable, "-m", "tests.drivers.spot.vendor_client", twin.port],
            capture_output=True,
            text=True,
            timeout=120.0,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        reported = json.loads(done.stdout.splitlines()[-1])
        assert len(twin.log.host("setpoint")) == 5, (
            "five commands: three twists, the arm, and one after the power cut"
        )
    assert reported["skew_s"] == pytest.approx(123.456, abs=0.05)
    assert reported["walked_m"] == pytest.approx(0.3, abs=0.06), "0.5 m/s for 0.6 s are 0.3 m"
    assert {key: reported[key] for key in reported if key not in ("skew_s", "walked_m")} == {
        "serial": "spot-twin",
        "bad_login": "InvalidLoginError",
        "lease": "body",
        "second_lease": "ResourceAlreadyClaimedError",
        "power_without_estop": "EstoppedError",
        "level": 4,
        "late": "ExpiredError",
        "far": "TooDistantError",
        "arrived": True,
        "joints": {"arm0.sh0": 0.1, "arm0.sh1": -1.0, "arm0.el0": 1.5, "arm0.wr0": 0.2},
        "has_arm": True,
        "stow": "UnsupportedError",
        "pose": "UnsupportedError",
        "trajectory": "UnsupportedError",
        "legs": 12,
        "motors_after_silence": 1,
        "after_the_cut": "NotPoweredOnError",
    }

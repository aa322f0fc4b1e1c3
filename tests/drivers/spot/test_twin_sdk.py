"""Test that the vendor's unmodified client (bosdyn-client 5.2.0) accepts the twin as a robot, and that the twin
moves, reports and refuses as the vendor's API says.

Each scene of ``vendor_client.py`` runs in its own process. The names of errors are classes of the vendor's client.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from strands_actors.testing import Twin

HASTE = 5.0
"""How many times faster than the robot the twin powers on, stands and sits in these scenes."""


def seen_by_the_vendor(scene: str, twin: Twin) -> dict[str, Any]:
    """Return what the vendor's client saw in a scene."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.drivers.spot.vendor_client", scene, twin.port],
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    reported: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return reported


def scene(name: str, tmp_path: Path, **options: Any) -> dict[str, Any]:
    with Twin("spot", tmp_path, options={"haste": HASTE, **options}) as twin:
        return seen_by_the_vendor(name, twin)


def test_the_vendors_client_drives_the_twin(tmp_path: Path) -> None:
    with Twin("spot", tmp_path, options={"haste": HASTE}) as twin:
        reported = seen_by_the_vendor("drive", twin)
        assert len(twin.log.host("setpoint")) == 4, "four commands: three twists, and one after the power cut"
    assert reported.pop("skew_s") == pytest.approx(123.456, abs=0.2)
    assert reported.pop("walked_m") == pytest.approx(0.3, abs=0.06), "0.5 m/s for 0.6 s are 0.3 m"
    assert reported == {
        "serial": "spot-twin",
        "no_login": "UnauthenticatedError",
        "bad_password": "InvalidLoginError",
        "bad_user": "InvalidLoginError",
        "bad_token": "InvalidTokenError",
        "renewed": "",
        "lease": "body",
        "second_lease": "ResourceAlreadyClaimedError",
        "power_without_estop": "EstoppedError",
        "level": 4,
        "late": "ExpiredError",
        "far": "TooDistantError",
        "has_arm": True,
        "force": "UnsupportedError",
        "freeze": "UnsupportedError",
        "fans": "UnimplementedError",
        "legs": 12,
        "motors_after_silence": 1,
        "after_the_cut": "NotPoweredOnError",
    }


def test_a_walk_from_sitting_past_its_limits_and_along_a_trajectory(tmp_path: Path) -> None:
    """A robot that sits stands up first. It limits a speed, because the API has no status for one that is too
    high."""
    reported = scene("walk", tmp_path)
    assert reported.pop("misses_m") < 0.01 and reported.pop("misses_rad") < 0.01
    assert reported == {
        "from_sitting": 2,  # STATE_TRANSITION
        "stood_up_and_walks": 0.5,
        "ended": 3,  # STATUS_COMMAND_TIMED_OUT
        "fastest": [1.89, 1.5],  # 1.6 m/s forwards and 1.0 m/s to the left
        "limited": 0.3,
        "frames": ["", "", "", "UnknownFrameError"],
        "on_the_way": [2, 1, 1],  # STATUS_IN_PROGRESS, BODY_STATUS_MOVING, FINAL_GOAL_STATUS_IN_PROGRESS
        "arrives": True,
        "there": [1, 2, 2],  # STATUS_STOPPED, BODY_STATUS_SETTLED, FINAL_GOAL_STATUS_ACHIEVABLE
        "too_far": 3,  # STATUS_COMMAND_TIMED_OUT
        "replaced": 2,  # STATUS_COMMAND_OVERRIDDEN
        "wrong_frame": "UnknownFrameError",
        "off": True,
    }


def test_the_body_is_posed_above_its_feet(tmp_path: Path) -> None:
    reported = scene("pose", tmp_path)
    assert reported.pop("took_s") == pytest.approx(3.0, abs=0.4), "the last of three poses is due after 3 s"
    assert reported.pop("feet_moved_m") < 1e-6 and reported.pop("back_m") < 1e-6
    assert reported == {
        "moving": 2,  # STATUS_IN_PROGRESS
        "done": 1,  # STATUS_IS_STANDING
        "yaw": 0.4,
        "raised_m": 0.05,
        "ahead_m": 0.07,
        "pitch": 0.3,
        "saturated": [1, 0.1, 0.6],
        "unknown_frame": "UnknownFrameError",
    }


def test_what_programs_ask_first(tmp_path: Path) -> None:
    assert scene("report", tmp_path) == {
        "names": ["arm0.link_wr1", "body", "feet_center", "flat_body", "gpe", "hand", "odom", "vision"],
        "valid": True,
        "heights": [0.0, 0.0],  # the frames begin at the body of the robot that sits
        "ground": -0.12,
        "has_arm": True,
        "links": [20, "body.obj"],
        "faults": [0, 0],
        "feet": [1, 1, 1, 1],  # CONTACT_MADE
        "stowed": 1,
        "metrics": ["distance", "time moving", "electric power"],
        "objects": "UnregisteredServiceNameError",
    }


def test_arm_and_gripper_move_by_name_by_joints_and_through_points(tmp_path: Path) -> None:
    reported = scene("arm", tmp_path)
    assert reported.pop("through_s") == pytest.approx(3.0, abs=0.4), "the second point is due after 3 s"
    assert 0.4 < reported.pop("left_s") < 0.8, "the shoulder turns by 1.8 rad with 2.5 rad/s"
    assert reported == {
        "ready": [2, True, 2],  # STATUS_IN_PROGRESS, arrives, STOWSTATE_DEPLOYED
        "carry": [2, True, 2],
        "stow": [2, True, 1],  # STOWSTATE_STOWED
        "arrives": True,
        "joints": {"arm0.sh0": 0.1, "arm0.sh1": -1.0, "arm0.el0": 1.5, "arm0.wr0": 0.2},
        "hand": [1.01, 0.07, 0.22],
        "past_a_limit": False,
        "stalled": [3, 2, 3.142],  # STATUS_STALLED, PLANNER_STATUS_MODIFIED
        "through": True,
        "claw": [1, 2, 50],  # STATUS_PROCESSING, STATUS_AT_GOAL
        "walk_goes_on": "STATUS_PROCESSING",
        "no_position": "InvalidRequestError",
    }


def test_the_hand_goes_where_the_vendors_client_sends_it(tmp_path: Path) -> None:
    reported = scene("hand", tmp_path)
    assert reported.pop("took_s") == pytest.approx(2.0, abs=0.4), "the pose is due after 2 s"
    assert reported.pop("misses") < 0.01 and reported.pop("held_while_walking") < 0.02
    assert reported.pop("raised_m") == pytest.approx(0.125, abs=0.03), "half of 0.5 m/s for 0.5 s"
    assert reported == {
        "far_m": 0.2,
        "arrives": True,
        "too_far": False,
        "gazes": True,
        "at_target": True,
        "unknown_frame": "UnknownFrameError",
        "follows": True,
    }


def test_the_feet_go_where_the_vendors_client_sends_them(tmp_path: Path) -> None:
    reported = scene("stance", tmp_path)
    assert reported.pop("misses_m") < 0.05
    assert reported == {"stanced": 1, "too_far": 3}


def test_the_vendors_client_gets_pictures(tmp_path: Path) -> None:
    assert scene("images", tmp_path) == {
        "sources": 20,
        "raw": [20, True],
        "sizes": [[640, 480], [424, 240], [640, 480]],
        "formats": [[1, 1], [2, 5], [1, 3]],
        "placed": [True, True, True],
        "unknown": "UnknownImageSourceError",
        "format": "UnsupportedImageFormatRequestedError",
        "pixels": "UnsupportedPixelFormatRequestedError",
        "ratio": "UnsupportedResizeRatioRequestedError",
    }


def test_a_robot_without_an_arm_reports_incompatible_hardware(tmp_path: Path) -> None:
    """The API refuses such a command in the feedback, and not at once (``RobotCommandFeedbackStatus``)."""
    missing = ["STATUS_INCOMPATIBLE_HARDWARE", None]
    assert scene("armless", tmp_path, arm=False) == {
        "has_arm": False,
        "stow": missing,
        "arrives": False,
        "joints": missing,
        "claw": missing,
        "walks": ["STATUS_INCOMPATIBLE_HARDWARE", 0.3],
        "hand": False,
    }


def test_a_robot_with_faults_refuses_until_they_are_cleared(tmp_path: Path) -> None:
    with Twin("spot", tmp_path, options={"haste": HASTE}) as twin:
        twin.order("fall")
        twin.order("break imu")
        assert seen_by_the_vendor("faulty", twin) == {
            "power": "FaultedError",
            "stand": "BehaviorFaultError",
            "behaviour": [[1, 1], [2, 2]],  # a fall, which can be cleared, and hardware, which cannot
            "hardware": [["imu", 3]],
            "cleared": ["", "NotClearedError"],
            "trigger": ["", "ServiceFaultAlreadyExistsError"],
            "service": ["cold"],
            "clear": ["", "ServiceFaultDoesNotExistError"],
            "register": ["", "ServiceAlreadyExistsError"],
            "silent": ["mine"],
            "update": "ServiceDoesNotExistError",
            "unregister": ["", "ServiceDoesNotExistError"],
        }
        twin.order("repair")
        assert seen_by_the_vendor("repaired", twin) == {"cleared": True, "state": 3}  # it stands

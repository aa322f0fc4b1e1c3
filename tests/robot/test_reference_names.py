"""Each name of strands-robots 0.5.3 exists here, or its refusal gives the replacement."""

from __future__ import annotations

import importlib
from typing import Any

import pytest

import strands_actors
from strands_actors import Robot
from strands_actors.caller.handle import reference_names, verbs
from strands_actors.caller.handle.vocabulary import call_of
from strands_actors.contract.driver import GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers import get_native_driver_class, list_native_drivers

ROBOT = "connect_eagerly stop cleanup get_status send_action run_policy start_task get_task_status stop_task"
TELEOP = "attach_teleop detach_teleop list_teleops teleoperate stop_teleoperate get_teleoperate_status mesh peer_id"
VERBS = {
    "booster_t1": "enable_upper_body move rotate_head change_mode read_state read_mode",
    "crazyflie": "setpoint_hz set_twist takeoff land emergency_stop",
    "earthrover": "move set_lamp speak read_state capture_frame",
    "koch": "bus",
    "microduck": "probe_hardware enable_torque relax emergency_stop read_state known_skills",
    "panda": "state",
    "reachy_mini": "play_move list_moves wake_up goto_sleep set_motors read_motors goto home get_volume set_volume "
    "play_sound set_wobbling say set_tracking tracked_face turn_to_sound look_at state_snapshot capture_frame",
    "so101": "bus start_recording stop_recording replay_episode connect disconnect start_teleop_publish",
    "spot": "state set_twist stand",
    "stretch3": "state set_twist",
    "unitree_go2": "state release_sport_mode",
    "ur5e": "state",
    "yahboom_m3pro": "home move read_state last_arm_command endpoint",
}
"""For one robot of each driver class of strands-robots: the public names of the class."""
SIM = """add_camera add_object add_robot apply_force attach_bodies create_world destroy eval_policy
evaluate_benchmark get_contacts get_frame get_state list_cameras list_robots load_scene
load_state mj_model move_object move_to open_viewer policy_result register_urdf remove_object
render render_depth reset robot_joint_names run_multi_policy save_episode save_state
set_gravity set_joint_positions start_policy start_recording step stop_policy stream_dataset
verify_dataset_episodes actuate_robot capabilities describe forward_kinematics get_camera_params
get_cameras_recording_status get_contact_forces get_energy get_features get_ground_height get_jacobian
get_mass_matrix get_sensor_data get_total_mass get_world_point inverse_dynamics list_bodies list_urdfs
multi_raycast patch_scene_mjcf randomize raycast register_benchmark_from_file
register_builtin_benchmarks replace_scene_mjcf rotate_wrist saturated_actuators set_obs_noise
start_cameras_recording start_cameras_recording_synchronous stop_cameras_recording"""
PACKAGE = """Policy MockPolicy create_policy list_providers register_policy Robot HardwareRosBridge
HardwareRtpsBridge Teleoperator list_policy_types Simulation SimWorld SimRobot SimObject SimCamera
list_robots get_robot list_discoverable is_discoverable list_urdf_only create_simulation list_backends
register_backend download_assets harness_memory create_judge_agent load_episode sample_frames
read_predicate_verdict write_label lerobot_camera lerobot_teleoperate lerobot_train run_policy
serial_tool train_policy use_lerobot use_ros use_rosbridge use_rtps pose_tool robot_mesh
init_device_connect init_device_connect_sync RobotDeviceDriver SimulationDeviceDriver
ReachyMiniDriver StreamingDatasetReader stream_dataset sync_dataset_to_bucket"""
"""The ``__all__`` of strands-robots."""
PORTS = {"serial": "/dev/ttyACM0", "address": "192.0.2.1"}
OWN_PORTS = {
    "crazyflie": "radio://0/80/2M/E7E7E7E7E7",
    "earthrover": "http://192.0.2.1:8000",
    "microduck": "/run/robotd.sock",
    "stretch3": None,
}


def missing(handle: object, names: str) -> list[str]:
    """Return the names that the handle does not have and whose refusal gives no replacement."""
    names_missing = []
    for name in names.split():
        try:
            getattr(handle, name)
        except AttributeError as refusal:
            if "strands-robots has it: here, " not in str(refusal):
                names_missing.append(f"{name}: {refusal}")
    return names_missing


@pytest.mark.parametrize("robot", sorted(VERBS))
def test_a_name_of_a_driver_exists_or_its_refusal_gives_the_replacement(robot: str) -> None:
    driver = get_native_driver_class(robot)
    assert driver is not None
    port = OWN_PORTS.get(robot, PORTS[driver.PORT_KIND])
    handle = Robot(robot, mode="real", **({} if port is None else {"port": port}))
    assert missing(handle, f"{ROBOT} {TELEOP} {VERBS[robot]}") == []


def test_a_name_of_a_simulation_exists_or_its_refusal_gives_the_replacement() -> None:
    assert missing(Robot("so101"), f"{ROBOT} {SIM}") == []


@pytest.mark.parametrize("name", ["spot.stand", "reachy_mini.wake_up", "crazyflie.takeoff", "unitree_go2.stand_up"])
def test_the_refusal_of_a_service_by_a_simulation_points_to_the_real_robot(name: str) -> None:
    robot, service = name.split(".")
    with pytest.raises(AttributeError, match=f"a service of the real {robot}.*transport='twin'"):
        getattr(Robot(robot), service)


def test_a_misspelled_name_is_not_a_name_of_strands_robots() -> None:
    arm = Robot("so101")
    assert not hasattr(arm, "conect") and not hasattr(arm, "connect") and not hasattr(arm, "volume")
    assert not hasattr(arm, "get_volume"), "get_volume is an alias of a service of another robot"
    with pytest.raises(AttributeError, match=r"no attribute 'conect'\Z"):
        arm.conect  # noqa: B018


def test_each_alias_refers_to_a_verb_or_service_of_this_package() -> None:
    arm = Robot("so101", mode="real", port="/dev/ttyACM0", peer_id="left")
    assert arm.stop_teleoperate == arm.stop_task and arm.emergency_stop == arm.stop
    assert arm.peer_id == arm.name == arm.mesh.peer_id == "left"
    services = {name for driver in _driver_classes() for name in driver.services({})}
    assert {own for own in reference_names.ALIASES.values() if not hasattr(type(arm), own)} <= services


def _driver_classes() -> list[type]:
    return [driver for name in list_native_drivers() if (driver := get_native_driver_class(name))]


@pytest.mark.parametrize("name", sorted(reference_names.PACKAGE))
def test_the_failed_import_of_a_strands_robots_name_gives_the_replacement(name: str) -> None:
    with pytest.raises(ImportError, match=f"no '{name}', which strands_robots has"):
        exec(f"from strands_actors import {name}")
    assert name not in dir(importlib.import_module("strands_actors"))
    assert not hasattr(strands_actors, "Simulatoin")


def test_a_name_of_the_package_exists_or_its_refusal_gives_the_replacement() -> None:
    here = dir(strands_actors)
    assert [name for name in PACKAGE.split() if name not in here and name not in reference_names.PACKAGE] == []


def test_mesh_and_peer_id_are_accepted_as_in_strands_robots() -> None:
    for mesh in (True, False, None):
        assert Robot("so101", mesh=mesh).tool_name == "so101"
    with pytest.raises(ValueError, match="tool_name and peer_id are both given"):
        Robot("so101", tool_name="a", peer_id="b")


@pytest.mark.parametrize(("given", "commanded"), [({}, {}), ({"z": None}, {}), ({"z": 0.4}, {"z": 0.4})])
def test_a_crazyflies_twist_is_a_command(given: dict[str, Any], commanded: dict[str, Any]) -> None:
    drone = get_native_driver_class("crazyflie")("crazyflie", "usb://0", {})  # type: ignore[misc]
    assert drone.check_service("set_twist", given) is None
    action = verbs.action_of_service(drone.SERVICES["set_twist"], {"vx": 0.2, **given})
    assert action == {"vx": 0.2, "vy": 0.0, "wz": 0.0, **commanded}
    seen = Observation(0, (0.0,) * len(drone.axes), (1,) * len(drone.axes))
    state = GateState(0, seen, (0.0,) * (len(drone.axes) + 1), 0, stream=False)
    assert not hasattr(drone.parse(action, state), "refusal")


def reachy(**inputs: Any) -> Any:
    driver = get_native_driver_class("reachy_mini")("reachy_mini", "192.0.2.1", {})  # type: ignore[misc]
    return call_of(driver, "goto", (), inputs)


def test_a_reachys_goto_accepts_the_arguments_of_strands_robots() -> None:
    call = reachy(head={"pitch": 5.0, "z": 10}, antennas=(20, -20), body_yaw=3, duration=1.0)
    ears = {"antenna_right": 20, "antenna_left": -20}
    assert call.action == {"head_pitch": 5.0, "head_z": 10, **ears, "body_yaw": 3, "duration": 1.0}


@pytest.mark.parametrize(
    ("inputs", "why"),
    [
        ({"head": {"tilt": 1}}, "head has no 'tilt'"),
        ({"antennas": [1]}, "antennas has 1 numbers"),
        ({"head": {"yaw": 1}, "head_yaw": 2}, "head_yaw is given twice"),
        ({"head": 5}, "head is"),
    ],
)
def test_an_invalid_pose_is_refused(inputs: dict[str, Any], why: str) -> None:
    assert why in reachy(**inputs).reason

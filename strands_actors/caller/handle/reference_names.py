"""Names of strands-robots 0.5 that a script may use on a handle, or import from the package.

``ALIASES``  verbs that have another name in this package, with the same arguments
``INSTEAD``  attributes that this package lacks; the ``AttributeError`` names the replacement
``PACKAGE``  imports that this package lacks; the ``ImportError`` names the replacement
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from strands_actors.surfaces.mesh.outcome import Outcome

ALIASES: Mapping[str, str] = {
    "destroy": "cleanup",
    "emergency_stop": "stop",
    "get_state": "state",
    "get_teleop_status": "get_task_status",
    "get_teleoperate_status": "get_task_status",
    "get_volume": "volume",
    "peer_id": "name",
    "read_state": "state",
    "set_motors": "motors",
    "set_tracking": "track_face",
    "state_snapshot": "state",
    "stop_teleop": "stop_task",
    "stop_teleoperate": "stop_task",
    "tracked_face": "tracking_status",
}

_SCENE = "put it into a model file: Robot(name, urdf_path='scene.xml')"
_PHYSICS = "state(), save_state() and load_state() give and set what moves"
_FILE = "load the model file with MuJoCo itself: the simulation runs in a process"
_FILM = "call video(path), or start_recording()"
_RECORD = "use record_dataset() of strands_actors"
_CAMERA = "make the robot with cameras= and call read_camera(name)"
_TELEOP = "one leader at a time: call attach_teleop() and stop_task()"

INSTEAD: Mapping[str, str] = {
    **dict.fromkeys(("connect", "robot"), "call connect_eagerly(), or use `with Robot(...) as robot:`"),
    "disconnect": "call cleanup()",
    "capture_frame": _CAMERA,
    "set_lamp": "call lamp(1) or lamp(0)",
    "enable_torque": "call enable() or disable()",
    "known_skills": "call skills()",
    "probe_hardware": "call connect_eagerly(), which returns why not",
    "read_mode": "call get_status()",
    "read_motors": "call get_status()",
    "set_wobbling": "say(text) moves the head by itself",
    "setpoint_hz": "it is a keyword of Robot(...), and get_status() has it",
    "endpoint": "get_status() has the port",
    "last_arm_command": "call get_observation()",
    **dict.fromkeys(("detach_teleop", "list_teleops"), _TELEOP),
    **dict.fromkeys(
        ("start_teleop_publish", "start_teleop_receive"),
        "lead the robot from its own host: robot.teleoperate(Teleoperator(...))",
    ),
    **dict.fromkeys(("foxglove_url", "foxglove_link"), "record to MCAP: `strands-actors record`"),
    "publish_ros_observation": "subscribe to strands/<robot>/state on the mesh",
    # These answers are for a real robot. A simulation has the first three names as methods.
    **dict.fromkeys(("start_recording", "stop_recording", "get_recording_status", "save_episode"), _RECORD),
    **dict.fromkeys(("replay_episode", "replay"), "use replay_episode(robot, DATASET, episode) of strands_actors"),
    **dict.fromkeys(("stream_dataset", "verify_dataset_episodes"), "use `strands-actors dataset show`"),
    # For a simulation.
    **dict.fromkeys(("start_policy", "run_multi_policy"), "call run_policy(policy, wait=False) of each robot"),
    **dict.fromkeys(("stop_policy",), "call stop_task()"),
    **dict.fromkeys(("policy_result", "list_policies_running"), "call get_task_status()"),
    **dict.fromkeys(("robot_joint_names", "robot_action_keys"), "get_observation() has them"),
    **dict.fromkeys(("list_robots", "list_robots_info", "get_robot_state"), "each robot is a handle: call state()"),
    "actuator_ranges": "a target past the range is refused with the limits",
    **dict.fromkeys(("add_robot", "create_world", "remove_robot"), "Robot(name) makes the world and the robot"),
    **dict.fromkeys(("load_scene", "set_gravity", "set_timestep", "register_urdf", "export_xml"), _SCENE),
    **dict.fromkeys(("set_body_properties", "set_geom_properties", "attach_bodies", "detach_bodies"), _SCENE),
    **dict.fromkeys(("move_object", "list_objects"), "call remove_object() and add_object()"),
    **dict.fromkeys(("render_all", "render_depth", "get_frame"), "call render(width, height, camera)"),
    **dict.fromkeys(
        ("list_cameras", "list_cameras_info", "remove_camera"), "render() of another name names the cameras"
    ),
    **dict.fromkeys(("open_viewer", "close_viewer"), "call view()"),
    **dict.fromkeys(
        ("start_cameras_recording", "start_cameras_recording_synchronous", "stop_cameras_recording"), _FILM
    ),
    "get_cameras_recording_status": _FILM,
    **dict.fromkeys(("get_camera_params", "get_world_point"), "the camera is the one that add_camera() made"),
    **dict.fromkeys(("patch_scene_mjcf", "replace_scene_mjcf", "randomize", "set_obs_noise"), _SCENE),
    **dict.fromkeys(("get_ground_height", "list_bodies", "list_urdfs", "get_total_mass"), _FILE),
    **dict.fromkeys(("raycast", "multi_raycast", "get_contact_forces", "get_sensor_data", "get_energy"), _FILE),
    **dict.fromkeys(("forward_kinematics", "get_jacobian", "get_mass_matrix", "inverse_dynamics"), _FILE),
    **dict.fromkeys(("get_features", "describe", "capabilities"), "call get_observation() and get_status()"),
    **dict.fromkeys(("rotate_wrist", "actuate_robot", "saturated_actuators"), "call move_to(targets, seconds=)"),
    **dict.fromkeys(("register_benchmark_from_file", "register_builtin_benchmarks"), "call eval_policy()"),
    **dict.fromkeys(("set_joint_positions", "set_joint_velocities", "apply_force"), _PHYSICS),
    **dict.fromkeys(
        ("mj_model", "mj_data", "get_body_state", "get_contacts"), "it runs in a process: call state()"
    ),
    **dict.fromkeys(("evaluate_benchmark", "list_benchmarks"), "call eval_policy()"),
    "set_gripper": "send_action({'gripper': ...})",
}

PACKAGE: Mapping[str, str] = {
    **dict.fromkeys(("Simulation", "create_simulation"), "Robot(name) makes a simulation"),
    **dict.fromkeys(("SimWorld", "SimObject", "SimCamera"), "use add_object() and add_camera() of Robot(name)"),
    **dict.fromkeys(
        ("list_backends", "register_backend"), "give Robot(name, backend=...) 'mujoco', 'newton' or 'isaac'"
    ),
    **dict.fromkeys(("get_robot", "list_discoverable", "is_discoverable"), "use list_driver_coverage()"),
    "list_urdf_only": "a URDF is a file of yours: Robot(name, urdf_path=...)",
    **dict.fromkeys(("list_providers", "list_policy_types"), "create_policy('?') names them"),
    "run_policy": "call run_policy() of a robot",
    "robot_mesh": "use get_peers(), tell() and estop()",
    "gr00t_inference": "start its server yourself, then policy_provider='remote'",
    **dict.fromkeys(("lerobot_train", "train_policy"), "train with LeRobot's own tools"),
    **dict.fromkeys(("lerobot_camera", "lerobot_teleoperate"), "use cameras= and Teleoperator(...)"),
    **dict.fromkeys(("pose_tool", "serial_tool", "use_lerobot"), "give the agent Robot(...) itself"),
    **dict.fromkeys(
        ("use_ros", "use_rosbridge", "use_rtps", "HardwareRosBridge", "HardwareRtpsBridge"),
        "robots on ROS have a driver: Robot(...)",
    ),
    **dict.fromkeys(
        ("stream_dataset", "StreamingDatasetReader", "load_episode", "sample_frames"),
        "use LeRobot's own dataset classes",
    ),
    **dict.fromkeys(
        ("create_judge_agent", "read_predicate_verdict", "write_label", "harness_memory"),
        "episodes are not judged here: `strands-actors dataset` shows, repairs and converts them",
    ),
    "sync_dataset_to_bucket": "nothing is uploaded: copy the folder of the dataset",
    **dict.fromkeys(
        ("init_device_connect", "init_device_connect_sync", "RobotDeviceDriver", "SimulationDeviceDriver"),
        "robots meet on the mesh: see docs/mesh.md",
    ),
    "ReachyMiniDriver": "use Robot('reachy_mini', mode='real')",
    "download_assets": "nothing is fetched: models are of this package, or a file of yours",
}


def hint(name: str) -> str:
    """Return the replacement of an attribute of strands-robots, as the end of a message.

    The text is empty if ``INSTEAD`` has no such attribute.
    """
    return f". strands-robots has it: here, {INSTEAD[name]}" if name in INSTEAD else ""


def package_hint(name: str) -> str | None:
    """Return the text of an ``ImportError`` for a name of strands_robots that this package lacks.

    Return None if ``PACKAGE`` has no such name.
    """
    if name not in PACKAGE:
        return None
    return f"strands_actors has no {name!r}, which strands_robots has. {PACKAGE[name]}"


class Mesh:
    """The attribute ``robot.mesh`` of strands-robots. It calls the functions of this package."""

    def __init__(self, own_name: Callable[[], str]) -> None:
        self._own_name = own_name

    @property
    def alive(self) -> bool:
        """Always True, since each call connects to the mesh by itself."""
        return True

    @property
    def peer_id(self) -> str:
        """The robot's name on the mesh."""
        return self._own_name()

    @property
    def peers(self) -> list[dict[str, Any]]:
        """The other robots on the mesh."""
        from strands_actors.surfaces.mesh import get_peers

        own = self._own_name()
        return [peer for peer in get_peers() if peer.get("peer_id") != own]

    def tell(self, target: str, instruction: str, **options: Any) -> dict[str, Any]:
        """Run a policy on another robot, and wait until it has ended.

        Args:
            target: The name of the other robot.
            instruction: Text for the policy.
            options: Those of ``strands_actors.tell``. ``policy_provider`` is ``mock`` by default.
        """
        from strands_actors.surfaces.mesh import tell

        # The default of strands-robots is ``mock``.
        return tell(target, instruction, **{"policy_provider": "mock", **options})

    def broadcast(self, cmd: Mapping[str, Any] | str) -> list[dict[str, Any]]:
        """Send a stop, or a command that only reads, to all robots on the mesh. Return their answers.

        Args:
            cmd: ``status``, ``state``, ``ping`` or a stop.
        """
        from strands_actors.surfaces.mesh import broadcast

        return broadcast(cmd)

    def emergency_stop(self) -> list[Outcome]:
        """Stop every robot on the mesh, and lock each until it is resumed. Return the result of each."""
        from strands_actors.surfaces.mesh import estop

        return estop()

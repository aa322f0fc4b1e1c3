#!/bin/sh
# Try `strands-actors ros2` with an installed ROS 2 Jazzy and rmw_zenoh. It moves a simulated arm only.
#
#   source /opt/ros/jazzy/setup.bash
#   sh tests/ros2/with_ros.sh
#
# Each line of the result is "ok" or "NOT OK" with the name of the check. The exit code is the number of failures.
# STRANDS_ACTORS is the command, if it is not on the path; PYTHON the interpreter that has the package.
set -u

export RMW_IMPLEMENTATION=rmw_zenoh_cpp
STRANDS_ACTORS=${STRANDS_ACTORS:-strands-actors}
PYTHON=${PYTHON:-python3}
failures=0
directory=$(mktemp -d)
export STRANDS_ACTORS_RUN="$directory/run"
mkdir -m 700 "$STRANDS_ACTORS_RUN"

for program in ros2 "$STRANDS_ACTORS" "$PYTHON"; do
    command -v "$program" >/dev/null || { echo "there is no command $program" >&2; exit 2; }
done

cleanup() {
    for pid in $arm $bridge $router; do
        kill -INT "$pid" 2>/dev/null
    done
    wait
    rm -rf "$directory"
}

check() { # check NAME PATTERN COMMAND...: the output of the command must contain the pattern
    name=$1 pattern=$2
    shift 2
    output=$(timeout 30 "$@" 2>&1)
    if printf '%s\n' "$output" | grep -q -- "$pattern"; then
        echo "ok      $name"
    else
        failures=$((failures + 1))
        echo "NOT OK  $name: $* did not print $pattern, but:"
        printf '%s\n' "$output" | sed 's/^/        /'
    fi
}

arm= bridge= router=
trap cleanup EXIT
trap 'exit 130' INT TERM

# A router that runs already is used, and the port is then in use.
ros2 run rmw_zenoh_cpp rmw_zenohd >"$directory/router.log" 2>&1 &
router=$!
sleep 3

"$PYTHON" - >"$directory/arm.log" 2>&1 <<'ARM' &
import signal, time
from strands_actors import Robot

arm = Robot(
    "so101", mode="real", transport="twin", cameras={"eye": {"type": "strands_actors.testing.still_camera:open_camera"}}
)
print(arm.connect_eagerly(), arm.release()["status"], flush=True)
signal.signal(signal.SIGINT, signal.default_int_handler)
try:
    time.sleep(600)
except KeyboardInterrupt:
    arm.cleanup()
ARM
arm=$!

"$STRANDS_ACTORS" ros2 --allow-motion >"$directory/bridge.log" 2>&1 &
bridge=$!
waited=0
until grep -q "on the graph" "$directory/bridge.log"; do
    waited=$((waited + 1))
    if [ "$waited" -gt 60 ]; then
        echo "the arm did not appear within 60 s:" >&2
        cat "$directory"/*.log >&2
        exit 2
    fi
    sleep 1
done
sleep 2

ros2 daemon stop >/dev/null 2>&1
check "the node is listed" "^/so101$" ros2 node list --no-daemon --spin-time 5
check "its topics are listed" "/so101/joint_states" ros2 topic list --no-daemon --spin-time 5
check "the type of a topic" "sensor_msgs/msg/JointState" ros2 topic info -v --no-daemon --spin-time 5 /so101/joint_states
check "its services are listed" "/so101/stop" ros2 service list --no-daemon --spin-time 5
check "joint states arrive" "shoulder_pan" ros2 topic echo --once /so101/joint_states sensor_msgs/msg/JointState
check "diagnostics arrive" "hardware_id: so101" ros2 topic echo --once /diagnostics diagnostic_msgs/msg/DiagnosticArray
check "the description is kept for later subscribers" "<robot name" \
    ros2 topic echo --once --full-length --qos-durability transient_local --qos-reliability reliable \
    /so101/robot_description std_msgs/msg/String
check "a stop reports each motor" "gripper confirmed" ros2 service call /so101/stop std_srvs/srv/Trigger "{}"
check "a resume energises the arm" "armed" ros2 service call /so101/resume std_srvs/srv/Trigger "{}"
check "a command moves the arm" "publishing" timeout 20 ros2 topic pub --rate 50 --times 200 \
    /so101/joint_command sensor_msgs/msg/JointState "{name: [shoulder_pan], position: [0.3]}"
check "the arm has moved" "0\.2[5-9]\|0\.3[0-4]" ros2 topic echo --once --field position /so101/joint_states sensor_msgs/msg/JointState
check "the pose of the tool arrives" "so101/base" ros2 topic echo --once /so101/tool_pose geometry_msgs/msg/PoseStamped
sleep 2 # The stream has to pause, and the arm holds after it.
check "a resume after the hold" "armed" ros2 service call /so101/resume std_srvs/srv/Trigger "{}"
check "a trajectory is carried out" "SUCCEEDED" ros2 action send_goal \
    /so101/follow_joint_trajectory control_msgs/action/FollowJointTrajectory \
    "{trajectory: {joint_names: [shoulder_pan], points: [{positions: [0.1], time_from_start: {sec: 2}}]}}"
check "a wrong goal is aborted with its reason" "elbow" ros2 action send_goal \
    /so101/follow_joint_trajectory control_msgs/action/FollowJointTrajectory \
    "{trajectory: {joint_names: [elbow], points: [{positions: [0.1], time_from_start: {sec: 2}}]}}"
check "the gripper is opened" "SUCCEEDED" ros2 action send_goal \
    /so101/gripper_cmd control_msgs/action/GripperCommand "{command: {position: 0.5}}"
check "a trajectory on a topic" "publishing" timeout 20 ros2 topic pub --once \
    /so101/joint_trajectory trajectory_msgs/msg/JointTrajectory \
    "{joint_names: [shoulder_pan], points: [{positions: [0.0], time_from_start: {sec: 1}}]}"
check "pictures arrive" "format: jpeg" ros2 topic echo --once --no-arr /so101/eye/image_raw/compressed \
    sensor_msgs/msg/CompressedImage
check "a bag is recorded" "joint_states" sh -c \
    "timeout -s INT 6 ros2 bag record -o $directory/bag /so101/joint_states; ros2 bag info $directory/bag"
check "an e-stop locks the arm" "locked" ros2 service call /so101/estop std_srvs/srv/Trigger "{}"

if [ "$failures" -gt 0 ]; then
    echo "$failures checks failed. What strands-actors ros2 printed:"
    sed 's/^/        /' "$directory/bridge.log"
fi
exit "$failures"

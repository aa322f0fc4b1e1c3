"""roslibpy: drive forwards for a second and stop."""

import sys
import time

import roslibpy

ros = roslibpy.Ros(host=sys.argv[1], port=int(sys.argv[2]))
ros.run(10)
drive = roslibpy.Topic(ros, "/cmd_vel", "geometry_msgs/Twist")
for speed in (*([0.3] * 10), 0.0):
    drive.publish(
        roslibpy.Message({"linear": {"x": speed, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}})
    )
    time.sleep(0.1)
drive.unadvertise()
ros.terminate()
print("drove")

"""Show robots on a ROS 2 graph, and obey commands from it, without an installation of ROS.

The middleware of the graph must be rmw_zenoh. ``kernel/channels/ros2`` has its bytes and names, and the I/O with
the graph. Only ``MeshClient`` has I/O with the robots.

joints        between the units of a robot and radians, metres and seconds
streams       which messages may command a robot
commands      messages to targets in the units of a driver
readings      the JSON of a robot's topics to ROS messages
trajectory    goals of the action, and the positions on their paths
motion        carry out planned motions
action_server goals, results and feedback of any action
action        the actions FollowJointTrajectory and GripperCommand, and the topic with trajectories
command_topics what the graph moves a robot with
cameras       pictures, while there is a subscriber
tool_pose     the pose of an arm's tool
writer        hold the lease (the right to command) for the graph
robot_node    one robot as a node of the graph
bridge        the process: robots come and go
"""

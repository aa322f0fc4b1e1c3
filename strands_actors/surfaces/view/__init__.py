"""Show a running robot live in Foxglove or Rerun: its joints, its model in 3-D, its cameras and its events.

The view runs in a separate process. It subscribes to the robot's telemetry on the mesh, as ``strands-actors echo``
does, so the robot never waits for it, and nothing is asked of the robot's wire. It can only read.

``watch``      joins the mesh, waits for the robot, and passes its samples on
``samples``    the telemetry as types; pure
``events``     what happened between two samples; pure
``model``      the robot's model: meshes, and the frame of each body from the positions of the joints
``viewer``     from samples to a sink
``sinks``      the interface of a display; ``foxglove_sink`` and ``rerun_sink`` implement it
"""

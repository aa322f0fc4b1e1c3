"""Exchange messages with the programs of a ROS 2 graph, without an installation of ROS.

The middleware of the graph must be rmw_zenoh. Only ``graph`` has I/O.

definitions   the fields of each ROS message and service
cdr           messages to bytes (XCDR1) and back
type_hash     the hash of a type's definition, which is part of each key
names         keys, liveliness tokens, quality of service, attachments
graph         the session with the router: nodes, publishers, subscriptions, services
"""

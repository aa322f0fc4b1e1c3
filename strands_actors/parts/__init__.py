"""Several robots as one: each part is a whole robot, and one more tree of processes commands them all.

``driver`` describes the robot that the parts make, as any driver does. ``wire`` and ``stop_channel`` reach no
hardware: they send orders to the gates of the parts, over the same sockets as any program of this user.
"""

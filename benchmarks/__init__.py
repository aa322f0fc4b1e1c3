"""Benchmarks: one question about speed per file. Each question has *sides* (programs that are compared), which are
measured in turn.

Each side runs in a separate process, in an order that is shuffled every round (``house``). A ratio is taken
within a round, and its median is compared with the goal. This package is measured as users run it: type checks,
queue limits, deadlines and the checks of each command are active, and all code is byte-compiled.

* A peer is another product that is compared with this package. Each peer has its own Python
  environment, which ``python -m benchmarks.peers`` makes (git-ignored). Peers command our simulated robots
  (twins) over the robot's own protocol, with the vendor's SDK. Fake modules replace an SDK only where the
  question does not include the connection to the robot.
* The time from a call to a frame is measured in the same way for every side: from CLOCK_MONOTONIC before
  the call to the time at which the simulated robot has read the frame.
* Before each command, ur-rtde's control interface waits until the robot's script has acknowledged the last
  one. With acknowledgements at 125 Hz, a stop after a setpoint was sent 3 to 11 ms late; at 500 Hz, 1 to
  3 ms.
"""

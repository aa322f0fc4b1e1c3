"""Benchmarks: one question about speed per file. Each question has *sides*, which are measured in turn.

Each side runs in a separate process, in an order that is shuffled every round (``house``). A ratio is taken
within a round, and its median is compared with the goal. The measured setup is that of a user: types,
bounds, deadlines and gates are active, and all code is byte-compiled, as in an installation.

* Peers have separate environments, which ``python -m benchmarks.peers`` makes (git-ignored). They drive our
  twins over the real wire, with the vendors' SDKs. A stand-in replaces an SDK only where the wire is not
  part of the question.
* The time from a call to a frame is measured alike for every side: from CLOCK_MONOTONIC before the call to
  the time at which the twin has read the frame.
* Before each command, ur-rtde's control interface waits until the robot's script has acknowledged the last
  one. With acknowledgements at 125 Hz, a stop after a setpoint was sent 3 to 11 ms late; at 500 Hz, 1 to
  3 ms.
"""

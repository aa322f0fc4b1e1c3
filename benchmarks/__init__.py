"""Questions about speed, one a file, each with *sides* that are measured in turn.

Each side runs in a process of its own, in an order shuffled every round (``house``). A ratio is
taken within a round; its median is held against the goal. Nothing is measured that is easier than
what a user gets: types, bounds, deadlines and gates are on, and everything is byte-compiled, as
what is installed is.

* Peers live apart: ``python -m benchmarks.peers`` makes their environments (git-ignored). They
  drive our twins over the real wire, with the vendors' own SDKs. Only where no wire is meant to be
  measured a stand-in takes the SDK's place.
* From a call to a frame is from CLOCK_MONOTONIC before the call to the twin's time of reading, for
  every side alike.
* ur-rtde's control interface waits, before each command, until the script has said that it took the
  last: heard at 125 Hz a stop behind a setpoint left 3 to 11 ms late, at 500 Hz 1 to 3 ms.
"""

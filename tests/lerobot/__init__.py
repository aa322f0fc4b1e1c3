"""What needs LeRobot itself, and with it gigabytes of torch: ``python -m tests lerobot``.

No part of the ordinary run. For each version an environment of its own is made once, by pip, below
``$STRANDS_ACTORS_LEROBOT`` (else ``~/.cache/strands-actors/lerobot``); the tests of this folder run
there.
"""

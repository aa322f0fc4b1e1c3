"""Run one of the vendor's own test programs against a twin: ``vendor_program.py FLEET_PATH FLEET_ID NAME``.

It runs where hello-robot-stretch-body is installed, whose package has these programs. NAME is a suite such as
``test_lift.TestLift``, or one test of it. The program is unmodified: the fleet folder names the twin's ports.
"""

from __future__ import annotations

import os
import sys
import unittest
from importlib.util import find_spec
from pathlib import Path

os.environ["HELLO_FLEET_PATH"], os.environ["HELLO_FLEET_ID"] = sys.argv[1:3]

if __name__ == "__main__":
    package = find_spec("stretch_body")
    assert package is not None and package.origin is not None
    # The programs are in a package named "test", which Python has, too. So they are imported by their file names.
    sys.path.insert(0, str(Path(package.origin).parents[1] / "test"))
    suite = unittest.TestLoader().loadTestsFromName(sys.argv[3])
    result = unittest.TextTestRunner(stream=sys.stderr).run(suite)
    sys.stderr.flush()
    os._exit(not result.wasSuccessful() or result.testsRun == 0)

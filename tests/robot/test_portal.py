"""The caller's loop, beside a script or a policy that computes. What the shorter interval gives is
measured by the questions ``stop`` and ``steady`` in benchmarks/."""

from __future__ import annotations

import subprocess
import sys

import pytest

from strands_actors.caller.portal import SWITCH_S


@pytest.mark.parametrize(("given_s", "found_s"), [(0.005, SWITCH_S), (0.00005, 0.00005)])
def test_a_thread_that_computes_lets_the_loop_run_soon_and_a_script_may_want_it_sooner(
    given_s: float, found_s: float
) -> None:
    code = (
        f"import sys; sys.setswitchinterval({given_s})\n"
        "from strands_actors.caller.portal import portal; portal()\n"
        "print(sys.getswitchinterval())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert float(done.stdout) == pytest.approx(found_s, abs=2e-6)  # whole microseconds

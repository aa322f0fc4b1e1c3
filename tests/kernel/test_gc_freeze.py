"""Collections skip the objects from before a ``frozen_objects`` block until the block ends. Each test has
its own process, because this is a state of the interpreter.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

OVERLAPPING = """
import gc
from strands_actors.kernel.health.gc_freeze import frozen_objects
one, other = frozen_objects(), frozen_objects()
frozen = [gc.get_freeze_count()]
one.__enter__()
frozen.append(gc.get_freeze_count())
later = [[] for _ in range(1000)]
other.__enter__()
frozen.append(gc.get_freeze_count())
one.__exit__(None, None, None)
frozen.append(gc.get_freeze_count())
other.__exit__(None, None, None)
frozen.append(gc.get_freeze_count())
before, first, second, between, after = frozen
assert after == 0 <= before < first < second - 1000 and between == second, frozen
"""

GARBAGE = """
import gc, weakref
from strands_actors.kernel.health.gc_freeze import frozen_objects
class Node: pass
def ring():
    node = Node()
    node.self = node
    return weakref.ref(node)
before = ring()
with frozen_objects():
    meanwhile = ring()
    gc.collect()
    assert meanwhile() is None and before() is not None
gc.collect()
assert before() is None
"""

FROZEN_BY_THE_PROGRAM = """
import gc
from strands_actors.kernel.health.gc_freeze import frozen_objects
gc.freeze()
with frozen_objects():
    pass
assert gc.get_freeze_count() > 1000
"""

AN_ERROR_INSIDE = """
import contextlib, gc
from strands_actors.kernel.health.gc_freeze import frozen_objects
with contextlib.suppress(KeyError), frozen_objects():
    raise KeyError
assert gc.get_freeze_count() == 0
"""


@pytest.mark.parametrize("program", [OVERLAPPING, GARBAGE, FROZEN_BY_THE_PROGRAM, AN_ERROR_INSIDE])
def test_objects_from_before_are_skipped_until_the_last_block_ends(program: str) -> None:
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)

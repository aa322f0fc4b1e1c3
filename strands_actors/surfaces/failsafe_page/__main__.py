"""Print the page: ``python -m strands_actors.surfaces.failsafe_page > docs/failsafe.html``."""

from __future__ import annotations

import sys

from . import page

sys.stdout.reconfigure(encoding="utf-8")  # type: ignore[union-attr]  # a real stream has it
sys.stdout.write(page())

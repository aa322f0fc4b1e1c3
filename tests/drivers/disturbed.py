"""The number of disturbed frames for the test of a codec: 20,000 in the suite, a million by hand."""

from __future__ import annotations

import os

DISTURBED = int(os.environ.get("STRANDS_ACTORS_FUZZ", "20000"))

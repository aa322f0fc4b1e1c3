"""Room for machines that import torch beside the tests."""

from __future__ import annotations

from strands_actors.testing import twin

twin.PATIENCE_S = 120.0

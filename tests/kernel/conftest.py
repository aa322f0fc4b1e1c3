"""Fixtures of the tests of nodes."""

from __future__ import annotations

import pytest

from .joints import JOINTS, Joint


@pytest.fixture(params=JOINTS)
def joint(request: pytest.FixtureRequest) -> Joint:
    return JOINTS[request.param]

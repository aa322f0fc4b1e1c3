"""Fixtures that these tests import from others."""

from tests.cli.conftest import cli as cli

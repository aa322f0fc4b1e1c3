"""What these tests take from others."""

from tests.cli.conftest import cli as cli

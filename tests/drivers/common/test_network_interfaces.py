"""Test interfaces by name. The loopback exists on every host."""

from __future__ import annotations

import socket

import pytest

from strands_actors.drivers.common.ports.network_interfaces import address_of

LOOPBACK = next(name for _, name in socket.if_nameindex() if name.startswith("lo"))


def test_a_name_is_the_address_that_it_has() -> None:
    assert address_of(LOOPBACK) == "127.0.0.1"


def test_an_address_is_itself() -> None:
    assert address_of("192.168.123.222") == "192.168.123.222"


@pytest.mark.parametrize("name", ["eth99", "1.2.3", "eth0; rm", "x" * 40])
def test_an_unknown_interface_is_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(ValueError, match=LOOPBACK):
        address_of(name)

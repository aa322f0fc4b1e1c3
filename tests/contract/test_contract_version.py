"""A driver of another package is refused if it was written for a contract that this package does not support."""

from __future__ import annotations

from typing import Any

import pytest

from strands_actors import contract
from strands_actors.contract import Driver, contract_version
from strands_actors.contract.contract_version import unsupported_contract


def written_for(version: Any) -> type[Any]:
    return type("MyArm", (), {"CONTRACT_VERSION": version})


def test_the_version_is_public_and_a_driver_that_declares_none_has_version_1() -> None:
    assert contract.CONTRACT_VERSION == 1
    assert Driver.CONTRACT_VERSION == 1
    assert unsupported_contract(type("Plain", (), {})) == ""
    assert unsupported_contract(written_for(contract.CONTRACT_VERSION)) == ""


def test_a_later_contract_is_refused_with_the_reason_and_the_remedy() -> None:
    assert unsupported_contract(written_for(2)) == (
        "MyArm was written for version 2 of the driver contract, but this release of strands-actors supports "
        "version 1. Install a newer release of strands-actors, or an older release of the driver"
    )


def test_an_older_contract_is_supported_until_it_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contract_version, "CONTRACT_VERSION", 3)
    assert [unsupported_contract(written_for(version)) for version in (1, 2, 3)] == ["", "", ""]
    monkeypatch.setattr(contract_version, "OLDEST_CONTRACT_VERSION", 2)
    for old in (written_for(1), type("MyArm", (), {})):
        assert unsupported_contract(old) == (
            "MyArm was written for version 1 of the driver contract, but this release of strands-actors supports "
            "versions 2 to 3. Install a newer release of the driver, or an older release of strands-actors"
        )


@pytest.mark.parametrize("version", ["1", 1.0, True, None, (1,)])
def test_a_version_that_is_no_whole_number_is_refused(version: object) -> None:
    assert unsupported_contract(written_for(version)) == (
        f"MyArm.CONTRACT_VERSION is {version!r}. Declare a whole number, such as 1"
    )


@pytest.mark.parametrize("version", [0, -1])
def test_a_version_that_never_existed_is_refused(version: int) -> None:
    assert f"was written for version {version} of the driver contract" in unsupported_contract(written_for(version))

"""A commit is released only if its files name one version, and if two builds of it are equal."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from strands_actors.version import __version__
from tests.release import address_of, differences, name_address, problems

from .test_imports import ROOT

MODULE = '__version__ = "0.2.0"\n'
DATED = "# Changelog\n\n## 0.2.0 (2026-12-24)\n\n### Added\n\n## 0.1.0 (2026-12-01)\n"
OPEN = DATED.replace("2026-12-24", "unreleased")


def test_this_checkout_could_be_built() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text()
    module = (ROOT / "strands_actors" / "version.py").read_text()
    assert list(problems(__version__, module, changelog, [])) == []


@pytest.mark.parametrize(
    ("changelog", "tags"), [(OPEN, []), (DATED, []), (DATED, ["v0.2.0"]), (OPEN, ["verified"])]
)
def test_a_trial_needs_no_date_and_a_release_needs_a_tag_and_a_date(changelog: str, tags: list[str]) -> None:
    assert list(problems("0.2.0", MODULE, changelog, tags)) == []


@pytest.mark.parametrize(
    ("version", "changelog", "tags", "reason"),
    [
        ("0.2.1", DATED.replace("0.2.0", "0.2.1"), [], "version.py does not have the version 0.2.1"),
        ("0.2.0", DATED.replace("0.2.0", "0.3.0"), [], "the first section of CHANGELOG.md is not 0.2.0"),
        ("0.2.0", "# Changelog\n", [], "the first section of CHANGELOG.md is not 0.2.0"),
        ("0.2.0", DATED, ["v0.2.1"], "the tag v0.2.1, and pyproject.toml has the version 0.2.0"),
        ("0.2.0", OPEN, ["v0.2.0"], r"Write '## 0.2.0 (YYYY-MM-DD)'"),
    ],
)
def test_what_does_not_agree_is_named(version: str, changelog: str, tags: list[str], reason: str) -> None:
    found = list(problems(version, MODULE, changelog, tags))
    assert len(found) == 1 and reason in found[0]


@pytest.mark.parametrize(
    ("remote", "address"),
    [
        ("https://host.example/robots/actors.git", "https://host.example/robots/actors"),
        ("https://robot:token@host.example/robots/actors/", "https://host.example/robots/actors"),
        ("git@host.example:robots/actors.git", "https://host.example/robots/actors"),
        ("ssh://git@host.example/robots/actors", "https://host.example/robots/actors"),
        ("/srv/git/actors", ""),
        ("file:///srv/git/actors", ""),
        ("../actors", ""),
    ],
)
def test_the_address_is_that_of_a_remote_on_a_public_host(remote: str, address: str) -> None:
    assert address_of(remote) == address


def test_a_release_names_its_address(tmp_path: Path) -> None:
    project = tmp_path / "pyproject.toml"
    own = (ROOT / "pyproject.toml").read_text()
    project.write_text(own)
    name_address(project, "")
    assert project.read_text() == own
    name_address(project, "https://host.example/robots/actors")
    named = tomllib.loads(project.read_text())
    urls = named["project"].pop("urls")
    assert named == tomllib.loads(own)
    assert urls["Changelog"] == f"https://host.example/robots/actors/blob/v{__version__}/CHANGELOG.md"
    assert set(urls) == {"Source", "Documentation", "Changelog", "Issues"}


def test_builds_that_are_not_equal_are_found(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    for folder in (one, other):
        folder.mkdir()
        (folder / "same").write_text("same")
        (folder / "changed").write_text(folder.name)
    (one / "missing").write_text("")
    assert differences(one, one) == []
    assert differences(one, other) == differences(other, one) == ["changed", "missing"]

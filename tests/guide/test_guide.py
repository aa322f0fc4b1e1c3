"""Each page of ``docs/guide`` runs: its Python blocks in order, in one new process, on twins. The commands of
its shell blocks exist."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from strands_actors.surfaces.cli import app
from tests.cli.command import PATIENCE_S, ROOT, Command
from tests.cli.conftest import cli

from .blocks import FENCE, agrees, announced, blocks_of

__all__ = ["cli"]

PAGES = sorted((ROOT / "docs" / "guide").glob("*.md"))
LONG = {"first-arm", "from-a-vendors-sdk", "from-ros2"}
"""Pages that would make the ordinary run longer than half a minute for all pages."""
TITLE = ["so101", "wire"]
"""Behind ``strands-actors`` this is the title of a process, in docs/architecture.md."""
INLINE = re.compile(r"`(strands-actors\s[^`]+)`")

CASES = [pytest.param(page, id=page.stem, marks=[pytest.mark.long] if page.stem in LONG else []) for page in PAGES]


@pytest.mark.real_time
@pytest.mark.parametrize("page", CASES)
def test_the_python_blocks_of_a_page_run_in_order(page: Path, cli: Command, tmp_path: Path) -> None:
    environment = {
        **cli.environment,
        "HF_LEROBOT_CALIBRATION": str(tmp_path / "calibration"),
        # The blocks call ``strands-actors``.
        "PATH": os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])),
    }
    done = subprocess.run(
        [sys.executable, "-m", "tests.guide.run_page", str(page)],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
    )
    print(done.stdout)
    assert done.returncode == 0, done.stderr
    cli.wait_until_gone()


def commands(page: Path) -> Iterator[list[str]]:
    """Yield the words of each ``strands-actors`` command in the shell blocks and in the prose of a page."""
    shell = [block.source.replace("\\\n", " ") for block in blocks_of(page) if block.language == "sh"]
    inline = [code.replace("\n", " ") for code in INLINE.findall(FENCE.sub("", page.read_text()))]
    for line in "\n".join((*shell, *inline)).splitlines():
        if "strands-actors" not in line:
            continue
        parts = shlex.shlex(line, posix=True, punctuation_chars=True)
        parts.whitespace_split = True
        words = list(parts)
        while "strands-actors" in words:
            words = words[words.index("strands-actors") + 1 :]
            yield words


def problem(words: list[str]) -> str:
    """Return the command or option of these words that does not exist; empty if all exist."""
    command = typer.main.get_command(app)
    for word in words:
        if word in ("&", "|", ">", "&&", ";"):
            break
        subcommands = getattr(command, "commands", None)
        if word.startswith("-"):
            if not any(word in (*option.opts, *option.secondary_opts, "--help") for option in command.params):
                return f"{command.name} has no {word}"
        elif subcommands is not None:
            if word not in subcommands:
                return f"there is no command {word}"
            command = subcommands[word]
    return ""


def test_the_commands_and_options_of_all_pages_exist() -> None:
    pages = (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"))
    used = [(page.name, words) for page in pages for words in commands(page)]
    assert {words[0] for _, words in used} >= {"demo", "tree", "calibrate", "drill", "mcp"}
    assert [f"{page}: {why}" for page, words in used if words != TITLE and (why := problem(words))] == []


def test_only_the_last_block_of_the_first_arm_needs_lerobot() -> None:
    marked = {page.stem: [block.needs_lerobot for block in blocks_of(page)] for page in PAGES}
    assert [name for name, blocks in marked.items() if any(blocks)] == ["first-arm"]
    assert marked["first-arm"].index(True) == len(marked["first-arm"]) - 1, (
        "tests/lerobot/test_first_arm.py runs it"
    )


# -- the rules themselves


@pytest.mark.parametrize(
    ("source", "code"),
    [
        ("print(1 + 1)  # 2", 0),
        ("print(1 + 1)  # 3", 1),
        ("print(1 + 1)", 1),
        ("1 / 0", 1),
        ("print(Path)  # a name of the runner", 1),
    ],
)
def test_a_page_fails_by_an_exception_or_another_output(source: str, code: int, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"A page.\n\n```python\n{source}\n```\n")
    command = [sys.executable, "-m", "tests.guide.run_page", str(page)]
    assert subprocess.run(command, cwd=ROOT, capture_output=True).returncode == code


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("tree --json", ""),
        ("dataset show pick --json", ""),
        ("dataset show pick --jsno", "show has no --jsno"),
        ("twin so101 --port-file follower.port &", ""),
        ("twinn so101", "there is no command twinn"),
        ("dataset look pick", "there is no command look"),
    ],
)
def test_a_command_or_option_that_does_not_exist_is_found(words: str, why: str) -> None:
    assert problem(words.split()) == why


@pytest.mark.parametrize(
    ("expected", "printed", "agree"),
    [
        ("9.9", "10.02", True),
        ("9.9", "14.1", False),
        ("[]", "['gripper']", False),
        ("{'status': 'success', ...}", "{'status': 'success', 'content': [1]}", True),
        ("{'status': 'success', ...}", "{'status': 'error', 'content': [1]}", False),
        ("past 110.1. Stay", "past 110.0. Stay", True),
        ("epoch 2", "epoch 3", False),
        ("", "a line that the page does not show", False),
    ],
)
def test_an_output_is_compared_with_the_announced_one(expected: str, printed: str, agree: bool) -> None:
    assert agrees(expected, printed) is agree


def test_comments_behind_and_below_a_print_announce_its_output() -> None:
    source = "print(1)  # one\nprint(2)\n# two\n# three\n\n# why\nx = 3  # no output\n"
    assert announced(source) == ["one", "two", "three"]

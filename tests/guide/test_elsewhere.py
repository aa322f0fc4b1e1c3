"""The Python blocks of the pages outside ``docs/guide`` run, or ``elsewhere`` has the reason why they do not. The
blocks in other languages can be parsed."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from docs.site import facts
from docs.site.robots import robot_page
from tests.cli.command import PATIENCE_S, ROOT, Command
from tests.cli.conftest import cli

from .blocks import blocks_of
from .elsewhere import MODEL, PAGES, How, pages_with_python, python_blocks, to_run
from .on_twins import answered, on_twins
from .run_page import ON_TWINS

__all__ = ["cli"]

QUICK = {"README.md", "docs/calibration.md", "docs/safety-evidence.md", "docs/versioning.md", "docs/cameras.md"}
"""Pages that run in a few seconds. The others are long tests."""
RUN = [
    pytest.param(name, marks=[] if name in QUICK else [pytest.mark.long], id=Path(name).stem)
    for name in PAGES
    if to_run(name)
]


@pytest.mark.real_time
@pytest.mark.parametrize("name", RUN)
def test_the_python_blocks_of_a_page_run(name: str, cli: Command, tmp_path: Path) -> None:
    (tmp_path / "my_arm.xml").write_text(MODEL)
    environment = {
        **cli.environment,
        "HF_LEROBOT_CALIBRATION": str(tmp_path / "calibration"),
        "PATH": os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"])),
    }
    for command in commands(name, tmp_path):
        done = subprocess.run(
            [sys.executable, *command],
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=2 * PATIENCE_S,
        )
        print(done.stdout)
        assert done.returncode == 0, done.stderr
    cli.wait_until_gone()


def commands(name: str, folder: Path) -> list[list[str]]:
    """Return the arguments of Python that run the blocks of a page."""
    how, numbers = PAGES[name].how, to_run(name)
    if how is How.AS_SCRIPT:
        scripts = []
        for number in numbers:
            script = folder / f"block_{number}.py"
            script.write_text(python_blocks(ROOT / name)[number - 1])
            scripts.append([str(script)])
        return scripts
    twins = [ON_TWINS] if how is How.ON_TWINS else []
    return [["-m", "tests.guide.run_page", *twins, str(ROOT / name), *map(str, numbers)]]


def test_every_page_with_python_blocks_is_run_or_has_a_reason() -> None:
    assert sorted(pages_with_python()) == sorted(PAGES)
    for name, blocks in PAGES.items():
        numbers = range(1, len(python_blocks(ROOT / name)) + 1)
        assert set(blocks.not_run) <= set(numbers), f"{name} has no such block"
        assert all(reason.strip() for reason in blocks.not_run.values())


def test_a_block_that_does_not_run_can_be_parsed() -> None:
    for name, blocks in PAGES.items():
        for number in blocks.not_run:
            source = python_blocks(ROOT / name)[number - 1]
            compile(source, name, "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)


def test_blocks_of_toml_and_json_can_be_parsed() -> None:
    readers = {"toml": tomllib.loads, "json": json.loads}
    found = [
        readers[block.language](block.source)
        for page in (ROOT / "docs").rglob("*.md")
        for block in blocks_of(page)
        if block.language in readers
    ]
    assert len(found) >= 3


def test_the_page_of_each_robot_has_an_example_that_starts_its_twin() -> None:
    for robot in facts.robots():
        example = robot_page(robot).partition("```python\n")[2].partition("```")[0]
        assert f'Robot("{robot}", mode="real", transport="twin")' in example
        compile(example, robot, "exec")


# -- the rules themselves


def test_only_the_port_of_a_robot_is_replaced() -> None:
    source = 'Robot("ur5e", mode="real", port="192.0.2.1", speed=0.5)\nRobot("ur5e")\nconnect(port="x")\n'
    names: dict[str, object] = {"connect": dict, "Robot": lambda *names, **keywords: seen.append((names, keywords))}
    seen: list[tuple[tuple[str, ...], dict[str, object]]] = []
    exec(compile(on_twins(source), "x", "exec"), {**names, "_answered": answered})
    assert seen == [
        (("ur5e",), {"mode": "real", "speed": 0.5, "transport": "twin"}),
        (("ur5e",), {}),
    ]


def test_a_call_that_answers_with_an_error_fails() -> None:
    assert answered({"status": "success"}) == {"status": "success"}
    with pytest.raises(RuntimeError):
        answered({"status": "error", "content": []})

"""The core install has every public name. A call that needs a missing extra is refused with the command that
installs it."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from .test_imports import PACKAGE, ROOT
from .test_public import PUBLIC


def needed(name: str, known: dict[str, metadata.Distribution]) -> dict[str, metadata.Distribution]:
    """Return a distribution and all its requirements without extras."""
    found = metadata.distribution(name)
    known[name] = found
    for line in found.requires or ():
        requirement = Requirement(line)
        is_needed = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        if is_needed and requirement.name not in known:
            needed(requirement.name, known)
    return known


@pytest.fixture(scope="module")
def core(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the packages of ``pip install strands-actors``, as links to the installed files."""
    folder = tmp_path_factory.mktemp("core")
    (folder / PACKAGE).symlink_to(ROOT / PACKAGE)
    for distribution in needed("strands-actors", {}).values():
        tops = {file.parts[0] for file in distribution.files or () if not file.parts[0].startswith("..")}
        for top in tops - {"__pycache__"}:
            place = Path(str(distribution.locate_file(top)))
            if not (folder / top).exists() and place.suffix != ".pth":
                (folder / top).symlink_to(place)
    return folder


def run(core: Path, script: str) -> str:
    """Run a script that finds the core install and Python's own modules, and nothing else."""
    first = f"import sys; sys.path.append({str(core)!r})"
    command = [sys.executable, "-I", "-S", "-c", f"{first}\n{script}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=core)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_core_install_has_no_extra(core: Path) -> None:
    script = (
        "from strands_actors.contract.extras import EXTRAS, missing\nprint(*(missing(e, e) or e for e in EXTRAS))"
    )
    printed = run(core, script)
    assert [name for name in ("record", "dataset", "cameras") if f"strands-actors[{name}]" not in printed] == []


@pytest.mark.parametrize(
    "script",
    [
        "from strands_actors import *\nprint(sorted(set(strands_actors.__all__) - set(dir())))",
        "print([n for n in strands_actors.__all__ if not hasattr(strands_actors, n)])",
        "import inspect\nfound = dict(inspect.getmembers(strands_actors))\n"
        "print(sorted(set(strands_actors.__all__) - set(found)))",
        "import pydoc\ntext = pydoc.plain(pydoc.render_doc(strands_actors))\n"
        "print([n for n in strands_actors.__all__ if n.strip('_').lower() not in text.lower()])",
    ],
    ids=["import-all", "hasattr", "getmembers", "help"],
)
def test_every_public_name_is_there_without_an_extra(core: Path, script: str) -> None:
    assert run(core, f"import strands_actors\n{script}").strip() == "[]"


@pytest.mark.parametrize("module", PUBLIC)
def test_a_public_module_shows_its_members_without_an_extra(core: Path, module: str) -> None:
    script = (
        f"import inspect\nimport {module} as m\nprint(sorted(set(m.__all__) - set(dict(inspect.getmembers(m)))))"
    )
    assert run(core, script).strip() == "[]"


def test_an_unknown_name_is_an_attribute_error(core: Path) -> None:
    assert run(core, "import strands_actors\nprint(hasattr(strands_actors, 'recrd'))").strip() == "False"


@pytest.mark.parametrize(
    ("call", "extra"),
    [
        ("record('so101', 'run.mcap')", "record"),
        ("read('run.mcap')", "record"),
        ("replay('run.mcap')", "record"),
        ("record_dataset('so101', 'pick', task='pick')", "dataset"),
    ],
)
def test_a_call_without_its_extra_names_the_extra(core: Path, call: str, extra: str) -> None:
    script = f"""
import strands_actors
try:
    strands_actors.{call}
except ImportError as missing:
    print(type(missing).__name__, missing)
"""
    printed = run(core, script)
    assert printed.startswith("MissingExtra ") and f"pip install 'strands-actors[{extra}]'" in printed, printed

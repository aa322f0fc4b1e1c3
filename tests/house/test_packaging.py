"""A wheel and a source distribution install the files of the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from strands_actors.version import __version__

ROOT = Path(__file__).resolve().parents[2]

NEEDED = (
    "strands_actors/__init__.py",
    "strands_actors/py.typed",
    "strands_actors/kernel/node.py",
    "strands_actors/supervisors/gate/gate.py",
    "strands_actors/drivers/__init__.py",
    "strands_actors/drivers/common/ports/half_duplex.py",
    "strands_actors/drivers/feetech/driver.py",
    "strands_actors/drivers/feetech/robots.toml",
)


EPOCH = 1_790_000_000


def build(kind: str, source: Path, into: Path, epoch: int | None = None) -> Path:
    """Build as ``python -m build --no-isolation`` does: run the backend in a separate process in ``source``."""
    script = f"import sys; from hatchling.build import build_{kind}; print(build_{kind}(sys.argv[1]))"
    command = [sys.executable, "-c", script, str(into)]
    environment = {name: value for name, value in os.environ.items() if name != "SOURCE_DATE_EPOCH"}
    if epoch is not None:
        environment["SOURCE_DATE_EPOCH"] = str(epoch)
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return into / done.stdout.split()[-1]


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("sdist", ROOT, tmp_path_factory.mktemp("sdist"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("wheel", ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def wheel_of_sdist(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = extracted(sdist, tmp_path_factory.mktemp("source"))
    return build("wheel", source, tmp_path_factory.mktemp("again"))


def extracted(sdist: Path, into: Path) -> Path:
    """Return the folder with the files of a source distribution."""
    with tarfile.open(sdist) as archive:
        archive.extractall(into, filter="data")
    return into / sdist.name.removesuffix(".tar.gz")


def names(wheel: Path) -> list[str]:
    with zipfile.ZipFile(wheel) as archive:
        return sorted(archive.namelist())


def test_a_wheel_has_everything_in_its_installed_place(wheel: Path) -> None:
    packed = names(wheel)
    assert [name for name in NEEDED if name not in packed] == []
    tops = {name.partition("/")[0] for name in packed}
    assert tops == {"strands_actors", wheel.name.removesuffix("-py3-none-any.whl") + ".dist-info"}
    assert [name for name in packed if "__pycache__" in name or name.endswith(".pyc")] == []
    assert len(packed) == len(set(packed))


def test_a_wheel_has_every_file_of_the_checkout(wheel: Path) -> None:
    kept = (".py", ".pyi", ".toml", ".typed")
    expected = {
        str((Path(directory) / file).relative_to(ROOT))
        for directory, _, files in os.walk(ROOT / "strands_actors", followlinks=True)
        for file in files
        if file.endswith(kept)
    }
    assert expected - set(names(wheel)) == set()


def test_a_wheel_built_from_the_sdist_is_the_same(wheel: Path, wheel_of_sdist: Path) -> None:
    assert names(wheel_of_sdist) == names(wheel)
    with zipfile.ZipFile(wheel) as one, zipfile.ZipFile(wheel_of_sdist) as other:
        for name in names(wheel):
            if name.startswith("strands_actors/"):
                assert one.read(name) == other.read(name), name


@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_a_build_depends_neither_on_its_folder_nor_on_the_times_of_the_files(
    kind: str, sdist: Path, tmp_path: Path
) -> None:
    """``python -m tests release`` builds a commit with the time of the commit. Others can build the same bytes."""
    sources = [extracted(sdist, tmp_path / name) for name in ("one", "another folder")]
    for file in sources[1].rglob("*"):
        os.utime(file, (EPOCH + 1000, EPOCH + 1000))
    built = [
        build(kind, source, tmp_path / f"built {number}", epoch).read_bytes()
        for number, (source, epoch) in enumerate(
            [(sources[0], EPOCH), (sources[1], EPOCH), (sources[0], EPOCH + 86_400)]
        )
    ]
    assert built[0] == built[1]
    assert built[0] != built[2], "SOURCE_DATE_EPOCH has no effect"


def test_the_module_has_the_version_of_the_package(wheel: Path) -> None:
    assert wheel.name == f"strands_actors-{__version__}-py3-none-any.whl"


def test_an_sdist_has_no_folder_that_would_shadow_a_users_own(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        tops = {name.split("/")[1] for name in archive.getnames()}
    assert {"strands_actors", "pyproject.toml", "README.md", "LICENSE"} <= tops
    assert tops & {"drivers", "supervisors", "tests"} == set()

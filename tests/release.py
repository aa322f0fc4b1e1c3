"""Build the files of a release from a commit: ``python -m tests release [COMMIT]``.

The files are written to ``dist/``: the wheel, the source distribution, the list of all packages that
an installation of the wheel contains (an SBOM in CycloneDX's format), and the SHA-256 of each file.

Only files of the commit are used, so changes that are not committed have no effect. Wheel and source
distribution are built twice, in two folders, and have to be equal byte by byte. All times in them are
the time of the commit. So with the same commit, Python and hatchling everyone gets the same files.

The files name the public address of the project (``[project.urls]``). It is that of the git remote
``origin``, which is known where a release is made, and not in the files of a commit.

It needs the extra ``release``, git, and the package index for the SBOM.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
SUMS = "SHA256SUMS"
TOOLS = ("hatchling", "build", "twine", "cyclonedx-bom")
"""The packages of the extra ``release``. The wheel contains the version of hatchling, so another version builds
another wheel."""


class NotReleased(Exception):
    """The commit cannot be released. The text has the reason and the remedy."""


def main(arguments: Sequence[str]) -> int:
    """Build, compare and check the files of a release. Return 0, or 1 if the commit cannot be released."""
    try:
        commit = git("rev-parse", "--verify", f"{arguments[0] if arguments else 'HEAD'}^{{commit}}")
        tags = git("tag", "--points-at", commit).split()
        epoch = git("log", "-1", "--format=%ct", commit)
        print(f"commit {commit}, time {epoch}, Python {sys.version.split()[0]}, {tools()}", flush=True)
        address = public_address()
        print(f"address {address}" if address else "no address: git has no remote `origin` on a public host")
        with tempfile.TemporaryDirectory(prefix="release-") as folder:
            release(commit, tags, epoch, address, Path(folder))
    except NotReleased as problem:
        print(f"release: {problem}", file=sys.stderr)
        return 1
    print((DIST / SUMS).read_text(), end="")
    return 0


def release(commit: str, tags: Sequence[str], epoch: str, address: str, folder: Path) -> None:
    """Write the files to ``DIST``.

    Raises:
        NotReleased: The versions differ, the two builds differ, or twine refuses a file.
    """
    environment = {**os.environ, "SOURCE_DATE_EPOCH": epoch}
    sources = [folder / "first", folder / "the second"]
    for source in sources:
        export(commit, source)
        name_address(source / "pyproject.toml", address)
    source = sources[0]
    project = tomllib.loads((source / "pyproject.toml").read_text())["project"]
    name, version = project["name"], project["version"]
    module, changelog = (source / "strands_actors/version.py").read_text(), (source / "CHANGELOG.md").read_text()
    if found := list(problems(version, module, changelog, tags)):
        raise NotReleased(". ".join(found))

    built = [build(each, environment) for each in sources]
    if different := differences(*built):
        names = ", ".join(different)
        raise NotReleased(f"two builds of {commit} differ: {names}. Find what depends on the time or the folder")
    files = sorted(built[0].iterdir())
    step("twine", "check", "--strict", *map(str, files))

    DIST.mkdir(exist_ok=True)
    for old in (*DIST.glob(f"{name.replace('-', '_')}-*"), DIST / SUMS):
        old.unlink(missing_ok=True)
    for file in files:
        (DIST / file.name).write_bytes(file.read_bytes())
    write_sbom(f"{name}=={version}", source / "pyproject.toml", folder / "installed", environment)
    written = sorted(path.name for path in DIST.glob(f"{name.replace('-', '_')}-*"))
    (DIST / SUMS).write_text("".join(f"{digest(DIST / each)}  {each}\n" for each in written))


def problems(version: str, module: str, changelog: str, tags: Sequence[str]) -> Iterator[str]:
    """Yield the places that do not agree with the version in ``pyproject.toml``.

    Args:
        version: The version in ``pyproject.toml``.
        module: The text of ``strands_actors/version.py``.
        changelog: The text of ``CHANGELOG.md``.
        tags: The tags of the commit. Without a tag such as ``v0.1.0`` the build is a trial, and the changelog needs
            no date.
    """
    if f'__version__ = "{version}"' not in module:
        yield f"strands_actors/version.py does not have the version {version} of pyproject.toml"
    heading = re.search(r"^## (\S+)(.*)$", changelog, re.MULTILINE)
    if heading is None or heading[1] != version:
        yield f"the first section of CHANGELOG.md is not {version}"
    releases = [tag for tag in tags if re.match(r"v\d", tag)]
    if [tag for tag in releases if tag != f"v{version}"]:
        yield f"the commit has the tag {', '.join(releases)}, and pyproject.toml has the version {version}"
    if releases and heading is not None and not re.fullmatch(r" \(\d{4}-\d\d-\d\d\)", heading[2]):
        yield f"CHANGELOG.md has no date. Write '## {version} (YYYY-MM-DD)'"


def public_address() -> str:
    """Return the address of the project's page on its public host, from the git remote ``origin``. Return an empty
    string if there is no such remote."""
    remotes = git("remote").split()
    return address_of(git("remote", "get-url", "origin")) if "origin" in remotes else ""


def address_of(remote: str) -> str:
    """Return the address of the page of a git remote; empty if the remote is on no public host."""
    found = re.fullmatch(r"(?:https://(?:[^/@]+@)?|ssh://[^/@]+@|[^/@:]+@)([\w-]+(?:\.[\w-]+)+)[:/](.+)", remote)
    return f"https://{found[1]}/{found[2].removesuffix('/').removesuffix('.git')}" if found else ""


def name_address(project: Path, address: str) -> None:
    """Add the pages of the project's address to ``pyproject.toml``. Without an address nothing is added."""
    if not address:
        return
    version = tomllib.loads(project.read_text())["project"]["version"]
    pages = {
        "Source": address,
        "Documentation": f"{address}/tree/v{version}/docs",
        "Changelog": f"{address}/blob/v{version}/CHANGELOG.md",
        "Issues": f"{address}/issues",
    }
    rows = "".join(f'{name} = "{page}"\n' for name, page in pages.items())
    project.write_text(f"{project.read_text()}\n[project.urls]\n{rows}")


def tools() -> str:
    """Return the names and versions of ``TOOLS``."""
    try:
        return ", ".join(f"{name} {metadata.version(name)}" for name in TOOLS)
    except metadata.PackageNotFoundError as missing:
        raise NotReleased(f"{missing.name} is not installed. Run: pip install -e '.[release]'") from missing


def export(commit: str, folder: Path) -> None:
    """Write the files of a commit to a new folder."""
    archive = folder.with_name(f"{folder.name}.tar")
    git("archive", "-o", str(archive), commit)
    with tarfile.open(archive) as files:
        files.extractall(folder, filter="data")


def build(source: Path, environment: dict[str, str]) -> Path:
    """Build the source distribution, and the wheel from it. Return the folder with both."""
    into = source.with_name(f"{source.name} dist")
    step("build", "--no-isolation", "--outdir", str(into), str(source), environment=environment)
    return into


def differences(one: Path, other: Path) -> list[str]:
    """Return the names of the files that are not equal in both folders."""
    names = {path.name for folder in (one, other) for path in folder.iterdir()}
    return sorted(
        name
        for name in names
        if not (one / name).exists() or not (other / name).exists() or digest(one / name) != digest(other / name)
    )


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_sbom(requirement: str, project: Path, installed: Path, environment: dict[str, str]) -> None:
    """Install the wheel from ``DIST`` into a new environment, and list the packages of this environment.

    The environment has no pip, so that the list contains only the package and its dependencies. ``--find-links``
    finds the wheel. If the path of the wheel were given, pip would note the path, and the list would contain it.
    The index is not asked for the wheel, because it may have another wheel of this version.
    """
    step("venv", "--without-pip", str(installed))
    python = str(installed / "bin" / "python")
    install = ("pip", "--python", python, "install", "-q")
    step(*install, "--no-deps", "--no-index", "--find-links", str(DIST), requirement)
    step(*install, "--only-binary", ":all:", requirement)
    sbom = DIST / f"{requirement.replace('-', '_').replace('==', '-')}.cdx.json"
    options = ("--pyproject", str(project), "--mc-type", "library", "--output-reproducible", "-o", str(sbom))
    step("cyclonedx_py", "environment", *options, python, environment=environment)


def step(module: str, *arguments: str, environment: dict[str, str] | None = None) -> None:
    """Run a module of this Python, and raise ``NotReleased`` if it fails."""
    print("$", module, *arguments, flush=True)
    if code := subprocess.run([sys.executable, "-m", module, *arguments], env=environment).returncode:
        raise NotReleased(f"{module} failed with the exit code {code}. Its message is above")


def git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        raise NotReleased(f"git {arguments[0]} failed. Its message is above")
    return done.stdout.strip()

"""The command ``dataset report``."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec

from strands_actors.contract.shown import harmless
from strands_actors.surfaces.dataset.errors import DamagedError
from strands_actors.surfaces.dataset.report.measure import measure
from strands_actors.surfaces.dataset.report.page import write_page
from strands_actors.surfaces.recording.errors import RecordingError

from .dataset import not_achieved
from .errors import Problem

HTML = (".html", ".htm")


def report(root: Path, out: Path | None, as_json: bool) -> int:
    """Write the page about a dataset. Return 1 if it is not certain which episodes the dataset has, else 0."""
    page = out or root.absolute().with_name(f"{root.absolute().name}.html")
    if page.suffix.lower() not in HTML:
        # An existing page is replaced. Another file must not be replaced by mistake.
        raise Problem(f"dataset report: {page} does not end with .html. Give the name of a page")
    try:
        measured = measure(root)
        write_page(measured, page)
    except DamagedError as damage:
        return not_achieved("report", damage)
    except (RecordingError, OSError) as problem:
        raise Problem(f"dataset report: {harmless(str(problem))}") from problem
    if as_json:
        # The pictures are only in the page.
        episodes = [msgspec.structs.replace(episode, pictures={}, curves=[]) for episode in measured.episodes]
        print(
            json.dumps(
                {**msgspec.to_builtins(msgspec.structs.replace(measured, episodes=episodes)), "page": str(page)}
            )
        )
    else:
        print(f"{page}: {len(measured.episodes)} episodes, {len(measured.good)} without a finding, "
              f"{len(measured.findings)} findings")  # fmt: skip
    return 0

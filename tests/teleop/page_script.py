"""The operator's page without a browser: its script in node."""

from __future__ import annotations

import shutil
import subprocess
from importlib import resources


def run_on_page(script: str) -> str:
    """Return what a script prints that is given the page's path as its first argument."""
    node = shutil.which("node")
    assert node is not None, 'mark the test with needs("Node.js")'
    page = resources.files("strands_actors.teleoperation.page").joinpath("page.html")
    told = subprocess.run([node, "-e", script, str(page)], capture_output=True, text=True, timeout=30.0, check=True)
    return told.stdout

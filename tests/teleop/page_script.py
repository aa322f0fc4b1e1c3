"""Run the script of the operator's page in Node.js, without a browser."""

from __future__ import annotations

import shutil
import subprocess
from importlib import resources


def run_on_page(script: str) -> str:
    """Run a script with the page's path as its first argument, and return its output."""
    node = shutil.which("node")
    assert node is not None, 'mark the test with needs("Node.js")'
    page = resources.files("strands_actors.teleoperation.page").joinpath("page.html")
    done = subprocess.run([node, "-e", script, str(page)], capture_output=True, text=True, timeout=30.0, check=True)
    return done.stdout

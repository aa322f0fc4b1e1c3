"""Build the site into a folder."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CONFIG = Path(__file__).with_name("mkdocs.yml")


def build(folder: Path) -> str:
    """Build the site into ``folder``. Return the problem, or an empty text.

    Args:
        folder: The folder of the site. Its old content is deleted.
    """
    try:
        from mkdocs.commands.build import build as build_site
        from mkdocs.config import load_config
        from mkdocs.exceptions import MkDocsException
    except ImportError as missing:
        return f"{missing.name} is not installed. Run: pip install -e '.[docs]'"
    shown = logging.StreamHandler(sys.stderr)
    shown.setLevel(logging.WARNING)
    logging.getLogger("mkdocs").addHandler(shown)
    try:
        config = load_config(str(CONFIG), site_dir=str(folder), strict=True)
        config.plugins.on_startup(command="build", dirty=False)
        build_site(config)
        config.plugins.on_shutdown()
    except MkDocsException as error:
        return str(error)
    return ""

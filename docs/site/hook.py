"""What MkDocs calls while it builds the site (https://www.mkdocs.org/user-guide/configuration/#hooks)."""

from __future__ import annotations

import os
import posixpath
import sys
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

# MkDocs loads this file by its path, so the root of the repository may not be among the folders of modules.
sys.path.append(str(Path(__file__).resolve().parents[2]))

from docs.site import api, diagrams, markdown, offline, robots, sources
from strands_actors.surfaces.drill.report import BadReport

LATER_IN_SEARCH = {"benchmarks.md": 0.1, "kill-matrix": 0.1, f"{api.FOLDER}/": 0.5}
"""Beginnings of places whose pages name every term many times. The search lists them after the pages that explain
the term. The number is the weight of a page; others have 1."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the robots and the public packages to the navigation, and let headings have the anchors of GitHub."""
    config.mdx_configs.setdefault("toc", {})["slugify"] = markdown.slug
    # Only a server shows this page, and its links would work only in the server's root.
    config.theme.static_templates.discard("404.html")
    for item in config.nav or ():
        for title, place in item.items():
            if place == robots.INDEX:
                item[title] = robots.navigation()
            elif place == api.INDEX:
                item[title] = api.navigation()
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made, and the source files that pages link to."""
    try:
        pages = sources.written_pages() | robots.pages() | api.pages()
    except BadReport as reason:
        raise PluginError(f"docs/reports: {reason}") from reason
    texts = {file.src_uri: file.content_string for file in files if file.is_documentation_page()} | pages
    linked = {path for place, text in texts.items() for path in sources.source_files(text, sources.origin(place))}
    pages |= {sources.place_of(path): sources.source_page(path) for path in sorted(linked)}
    for place, text in pages.items():
        files.append(File.generated(config, place, content=text))
    return files


def on_page_markdown(text: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Change links, lists and diagrams of a page."""
    place = page.file.src_uri
    folder = posixpath.dirname(place) or "."
    for beginning, weight in LATER_IN_SEARCH.items():
        if place.startswith(beginning):
            page.meta["search"] = {"boost": weight}
    text = sources.relinked(text, place)
    try:
        return markdown.adapted(text, place, lambda path: os.path.relpath(path, folder))
    except diagrams.Missing as missing:
        raise PluginError(str(missing)) from missing


def on_page_content(page_html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put wide tables into boxes that scroll."""
    return markdown.wide_tables(page_html)


def on_post_build(config: MkDocsConfig, **_: Any) -> None:
    """Check that the site loads nothing from a network."""
    if found := offline.foreign_resources(Path(config.site_dir)):
        raise PluginError(f"the site loads from a network: {', '.join(found)}")

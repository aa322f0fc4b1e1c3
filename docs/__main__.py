"""Build the documentation site: ``python -m docs [FOLDER]``, in the root of the repository.

The site needs no network, neither to build nor to read: it opens from a folder. It needs the extra
``docs``. Any warning of MkDocs fails the build.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from docs.site.build import build

DEFAULT = Path("build/docs")


def main(arguments: list[str]) -> int:
    if len(arguments) > 1 or (arguments and arguments[0].startswith("-")):
        print("usage: python -m docs [FOLDER]", file=sys.stderr)
        return 2
    folder = Path(arguments[0]) if arguments else DEFAULT
    began = time.monotonic()
    problem = build(folder.resolve())
    if problem:
        print(f"docs: {problem}", file=sys.stderr)
        return 1
    print(f"{folder / 'index.html'}: {time.monotonic() - began:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

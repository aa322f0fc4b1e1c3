"""Build the documentation site: ``python -m docs [FOLDER]``, in the root of the repository.

The site needs no network, neither to build nor to read: it opens from a folder. It needs the extra
``docs``. Any warning of MkDocs fails the build.

``python -m docs pictures [NAME ...]`` makes its pictures anew, without a display: of the robots, of the
demo and of the terminal.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from docs.site.build import build

DEFAULT = Path("build/docs")


def main(arguments: list[str]) -> int:
    if arguments[:1] == ["pictures"]:
        # Import this late, because building the site needs neither MuJoCo nor matplotlib.
        from docs.studio.command import main as make_pictures

        return make_pictures(arguments[1:])
    if len(arguments) > 1 or (arguments and arguments[0].startswith("-")):
        print("usage: python -m docs [FOLDER], or python -m docs pictures [NAME ...]", file=sys.stderr)
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

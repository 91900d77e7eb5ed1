"""Page of the studio: viser's page with a title, an icon, and what the studio shows over the scene.

viser's page is one file, whose script holds all of its client and blocks the page for seconds while it starts. Here,
the text and the buttons of the studio come first in the file, and the script starts once they are on the screen. The
page still works without them: viser's panel has a control for everything.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from urllib.parse import quote

import viser

TITLE = "RoboAssembly"
_FILES = resources.files(__name__)
_SCRIPT, _ROOT = '<script data-p="', '<div id="root"></div>'


def make_page() -> str:
    """Return the page of the studio.

    Raises:
        RuntimeError: viser's page is not built as that of 1.1.
    """
    page = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_text(encoding="utf-8")
    if page.count(_SCRIPT) != 1 or page.count(_ROOT) != 1 or page.count("</script>") != 1:
        raise RuntimeError(f"viser {viser.__version__} has another page than 1.1; install viser 1.1")
    start = page.index(_SCRIPT)
    end = page.index("</script>") + len("</script>")
    client = page[start:end].replace(_SCRIPT, f'<script type="text/plain" id="viser-client" {_SCRIPT[8:]}', 1)
    head = (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8" />\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1" />\n'
        '<meta name="description" content="Assemble furniture in the browser" />\n'
        '<meta name="theme-color" content="#b84d06" />\n'
        f"<title>{TITLE}</title>\n"
        f'<link rel="icon" href="data:image/svg+xml,{quote(_text("icon.svg").strip())}" />\n'
        f"<style>\n{_text('style.css')}</style>\n</head>\n"
    )
    body = (
        f"<body>\n<noscript>The studio needs JavaScript.</noscript>\n{_text('shell.html')}{_ROOT}\n"
        f"{client}\n<script>\n{_text('page.js')}</script>\n</body>\n</html>\n"
    )
    return head + body


def _text(name: str) -> str:
    return (_FILES / name).read_text(encoding="utf-8")

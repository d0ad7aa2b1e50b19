"""The site: built with warnings as errors, its links, its size, and how it looks.

    python tests/benchmarks/pages.py [--out FOLDER] [--json FILE] [--fast]

Prints the seconds of the build and MB, every link inside that leads nowhere, and what a
search finds. Leaves pictures of pages at two widths in OUT/pictures, to be looked at. Needs
Chromium. `--fast` does not run the notebooks.
"""

import argparse
import http.server
import json
import subprocess
import sys
import tempfile
import threading
import time
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE.parent)]

from browser import Browser  # noqa: E402

PAGES = (
    "index",
    "start",
    "tutorials/pattern",
    "tutorials/board",
    "how/method",
    "how/flags",
    "explain/physics",
    "reference/commands",
    "reference/flags",
    "reference/python",
    "reference/api/sensor",
    "measured/methods",
    "measured/shapes",
    "which_method",
)
WIDTHS = (1400, 420)
SEARCHED = {"calibrate": "how/calibrate", "HIGH_RESIDUAL": "how/flags", "Disc": "sensor"}


class Links(HTMLParser):
    """What a page links to, and the places inside it."""

    def __init__(self, text: str):
        super().__init__()
        self.links: list[str] = []
        self.places: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag, attrs) -> None:
        told = dict(attrs)
        self.places |= {v for k, v in told.items() if k in ("id", "name") and v}
        for name in ("href", "src"):
            if told.get(name):
                self.links.append(str(told[name]))


class Quiet(http.server.SimpleHTTPRequestHandler):
    """A server that does not tell of each request."""

    def log_message(self, *_: object) -> None:
        pass


def broken(site: Path) -> list[str]:
    """Links inside the site that lead nowhere."""
    made = (path for path in site.rglob("*.html") if "_static" not in path.parts)
    pages = {path: Links(path.read_text()) for path in made}
    wrong = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or link.startswith("#"):
                continue
            target = (path.parent / unquote(parts.path)).resolve()
            target = target / "index.html" if target.is_dir() else target
            if not target.exists():
                wrong.append(f"{path.relative_to(site)} -> {link}")
            elif parts.fragment and target in pages:
                if unquote(parts.fragment) not in pages[target].places:
                    wrong.append(f"{path.relative_to(site)} -> {link}")
    return wrong


def looked_at(site: Path, out: Path) -> dict:
    """Pictures of pages at two widths, and what the search finds."""
    handler = partial(Quiet, directory=str(site))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    where, found = f"http://127.0.0.1:{server.server_port}", {}
    out.mkdir(parents=True, exist_ok=True)
    wide = []
    with Browser() as page:
        for width in WIDTHS:
            page.resize(width, 1000)
            for name in PAGES:
                page.go(f"{where}/{name}.html")
                page.wait("document.readyState === 'complete'")
                time.sleep(0.3)
                page.picture(out / f"{name.replace('/', '-')}-{width}.png")
                if page.value("document.documentElement.scrollWidth") > width + 1:
                    wide.append(f"{name} at {width}")
        page.resize(WIDTHS[0], 1000)
        for word, wanted in SEARCHED.items():
            page.go(f"{where}/search.html?q={word}")
            page.wait("document.querySelectorAll('#search-results li a').length > 0", 20)
            time.sleep(1)
            links = page.value(
                "[...document.querySelectorAll('#search-results li a')].map(a => a.href)"
            )
            hits = list(dict.fromkeys(link.split("?")[0].split("#")[0] for link in links))
            found[word] = {"pages": len(hits), "found": any(wanted in h for h in hits)}
        page.picture(out / "search.png")
    server.shutdown()
    return {"search": found, "wider_than_the_window": wide, "complaints": len(page.said)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--fast", action="store_true")
    given = parser.parse_args()
    out = given.out or Path(tempfile.mkdtemp())
    site = out / "site"
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html"]
    command += ["-D", "nb_execution_mode=off"] if given.fast else []
    began = time.monotonic()
    done = subprocess.run([*command, "-j", "2", str(ROOT / "notebooks"), str(site)])
    told = {"status": done.returncode, "build_s": round(time.monotonic() - began, 1)}
    sizes = [path.stat().st_size for path in site.rglob("*") if path.is_file()]
    told |= {"MB": round(sum(sizes) / 1e6, 1), "pages": len(list(site.rglob("*.html")))}
    told |= {"broken_links": broken(site)} | looked_at(site, out / "pictures")
    print(json.dumps(told, indent=1))
    if given.json:
        given.json.write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()

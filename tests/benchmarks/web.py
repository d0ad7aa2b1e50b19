"""Tries the page in the browser: pictures a second, memory, an hour's file, strangers.

    python tests/benchmarks/web.py live [--seconds 600]      # beside it: the loop without
    python tests/benchmarks/web.py hour [--hours 1] [--folder FOLDER]     # 2.7 GB an hour
    python tests/benchmarks/web.py strangers [--requests 10000]

Live and hour need Chromium. Each prints one JSON object.
"""

import argparse
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parents[1]), str(HERE.parent)]

from browser import address, Browser  # noqa: E402

# What the page reads of a row.
SHOWN = (
    "contact_count",
    "contact_xy",
    "contact_conductance",
    "contact_covariance",
    "residual",
    "flags",
)

TOMOJAX = [sys.executable, "-c", "from tomojax.cli import main; main()"]


def family(root: int) -> list[int]:
    """A process and all that it has started."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(path.parent.name)] = int(
                path.read_text().rpartition(")")[2].split()[1]
            )
        except OSError:
            continue
    found = [root]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def memory(processes: list[int]) -> float:
    """Shares of memory that processes have, MB: each page counts once."""
    total = 0
    for number in processes:
        try:
            text = Path(f"/proc/{number}/smaps_rollup").read_text()
        except OSError:
            continue
        total += int(re.search(r"^Pss:\s+(\d+)", text, re.M)[1])  # pyright: ignore
    return total / 1024


def page_process(root: int) -> int:
    """The one that serves the page."""
    for number in family(root):
        if b"tomojax.hardware.web.live" in Path(f"/proc/{number}/cmdline").read_bytes():
            return number
    raise AssertionError("no page's process")


def counted(text: str) -> dict[str, int]:
    """What the loop says that it has counted."""
    return {name: int(n) for n, name in re.findall(r"(\d+) (slots|lost|skipped)\b", text)}


@contextmanager
def command(*words: str):
    """A command with a page, and the page's address."""
    pipe = subprocess.PIPE
    given = {"stdout": pipe, "stderr": subprocess.STDOUT, "text": True}
    process = subprocess.Popen([*TOMOJAX, *words], **given)  # pyright: ignore
    try:
        assert process.stdout is not None
        yield process, address(iter(process.stdout.readline, ""))
    finally:
        process.terminate()
        process.wait()


def live(seconds: float) -> dict:
    """The loop alone, then with a page that is looked at; from a virtual rig."""
    found: dict = {"asked_s": seconds}
    with tempfile.TemporaryDirectory() as folder:
        words = ["live", "virtual", "--seconds", str(seconds), "--record"]
        alone = [*TOMOJAX, *words, f"{folder}/alone.h5", "--view", "none"]
        told = subprocess.run(alone, check=True, capture_output=True, text=True)
        found["alone"] = counted(told.stdout)
        words += [f"{folder}/page.h5", "--view", "web"]
        with command(*words) as (process, url), Browser() as page:
            page.go(url)
            page.wait("document.body && document.body.dataset.pictures > 5")
            served, began = page_process(process.pid), time.monotonic()
            first = int(page.value("document.body.dataset.pictures"))
            pictures, kept, ages = first, [], []
            while time.monotonic() - began < 0.9 * seconds - 10:
                time.sleep(min(5.0, seconds / 20))
                if process.poll() is not None:
                    break
                pictures = int(page.value("document.body.dataset.pictures"))
                age = page.value("document.getElementById('told').innerText")
                ages += [int(a) for a in re.findall(r"(\d+) ms behind", age)]
                both = memory([served]), memory(family(page.process.pid))
                kept.append((time.monotonic() - began, *both))
            spent = kept[-1][0]
            found["pictures_per_s"] = (pictures - first) / spent
            found["age_ms_median_max"] = [float(np.median(ages)), max(ages)]
            for name, column in zip(("page_MB", "browser_MB"), np.array(kept).T[1:]):
                third = max(1, len(column) // 3)
                parts = column[:third].mean(), column[-third:].mean()
                found[f"{name}_first_last_third"] = [round(float(p), 1) for p in parts]
            found["complaints"] = len(page.said)
            assert process.stdout is not None
            found["with_page"] = counted(process.stdout.read())
    return found


def hour_file(path: Path, rows: int, rate: float = 10e3, contacts: int = 2) -> None:
    """Results of `rows` slots: contacts that draw eights, some flags, a mark."""
    import h5py

    from tomojax.methods import fields_of_rows

    xy = 0.01 + 0.02 * np.indices((8, 8)).reshape(2, -1).T
    with h5py.File(path, "w") as file:
        file.attrs.update(
            schema="tomojax-results", schema_version=1, method="follow", rate="slot",
            size=[0.16, 0.16], electrode_xy=xy, drive_voltage=4.5, sheet_resistance=1e4,
            configuration="{}", recording="none.h5",
            marks=json.dumps([[rows / rate / 3, "a third"]]),
        )  # fmt: skip
        sizes = {"C": contacts}
        kinds = {"t": ((), "<f8")} | {
            name: (tuple(int(sizes.get(s, s)) for s in field.sizes), field.kind)
            for name, field in fields_of_rows().items()
            if name in SHOWN
        }
        made = {n: file.create_dataset(n, (rows, *s), k) for n, (s, k) in kinds.items()}
        for start in range(0, rows, 1 << 20):
            stop = min(start + (1 << 20), rows)
            t = np.arange(start, stop) / rate
            phase = t[:, None] + np.arange(contacts)
            made["t"][start:stop] = t
            made["contact_count"][start:stop] = 1 + (t % 7 > 3)
            eights = 0.05 * np.sin(phase), 0.035 * np.sin(2 * phase)
            made["contact_xy"][start:stop] = 0.08 + np.stack(eights, -1)
            strength = 1e-5 * (2 + np.sin(t / 60))[:, None] * np.ones(contacts)
            made["contact_conductance"][start:stop] = strength
            spread = np.tile(np.float32([1e-6, 2e-6, 5e-7]), (stop - start, contacts, 1))
            made["contact_covariance"][start:stop] = spread
            made["residual"][start:stop] = np.full(stop - start, 1e-3, "f4")
            made["flags"][start:stop] = np.where(t % 1000 < 1e-3, 16384, 0)


def hour(hours: float, folder: Path | None) -> dict:
    """From the command to the first picture; then zooms, the whole file, memory."""
    rows, found = int(36e6 * hours), {"hours": hours}
    with tempfile.TemporaryDirectory(dir=folder) as made:
        path = Path(made) / "hour.h5"
        hour_file(path, rows)
        found["GB"] = path.stat().st_size / 1e9
        with Browser() as page:
            began = time.monotonic()
            with command("view", str(path)) as (process, url):
                found["address_s"] = time.monotonic() - began
                page.go(url)
                page.wait("document.body && document.body.dataset.pictures > 0")
                found["first_picture_s"] = time.monotonic() - began
                at_first = memory(family(process.pid))
                page.wait("document.getElementById('thinned').textContent === ''", 600)
                found["all_rows_s"] = time.monotonic() - began
                kept = []
                for k in range(40):
                    t = rows / 1e4 * (k % 20 + 0.5) / 20
                    width = rows / 1e4 / (k % 7 + 1) ** 3
                    asked = f"data?t={t}&from={t - width / 2}&to={t + width / 2}"
                    since = time.monotonic()
                    page.value(
                        f"fetch('{asked}').then((a) => a.text()).then((a) => a.length)"
                    )
                    kept.append(time.monotonic() - since)
                found["zoom_s_median_max"] = [float(np.median(kept)), max(kept)]
                found["MB_at_first_at_last"] = [at_first, memory(family(process.pid))]
    return found


def strangers(requests: int) -> dict:
    """Junk, connections that stay silent, and one that reads a byte a second."""
    generator, found = np.random.default_rng(1), {"requests": requests}
    words = "live", "virtual", "--seconds", str(30 + requests / 100), "--view", "web"
    with command(*words) as (process, url):
        where, served = urlsplit(url), page_process(process.pid)
        place, before = ("127.0.0.1", where.port), memory([served])
        slow = socket.create_connection(place)
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        right = f"GET {where.path}%s HTTP/1.1\r\nHost: {where.netloc}\r\n\r\n"
        slow.sendall((right % "bokeh.min.js").encode())
        slow.settimeout(0.01)
        due, waits, answers, open_ones = 0.0, [], {}, []
        heads = (
            f"GET / HTTP/1.1\r\nHost: {where.netloc}\r\n\r\n",
            f"GET /{'a' * 22}/data HTTP/1.1\r\nHost: {where.netloc}\r\n\r\n",
            (right % "data").replace(where.netloc, "evil.example"),
            (right % "data")[:-2] + "Origin: http://evil.example\r\n\r\n",
        )
        for k in range(requests):
            one = socket.create_connection(place, timeout=10)
            try:
                if k % 6 < 4:
                    one.sendall(heads[k % 6].encode())
                    said = one.recv(1000)[:12].decode(errors="replace")
                    answers[said] = answers.get(said, 0) + 1
                elif k % 6 == 4:
                    one.sendall(generator.bytes(500) + b"\r\n\r\n")
            except OSError:
                pass
            open_ones = [*open_ones, one][-100:]  # the rest stay open and silent
            if time.monotonic() > due:
                due = time.monotonic() + 1
                try:
                    slow.recv(1)
                except OSError:
                    pass
                since = time.monotonic()
                with socket.create_connection(place, timeout=10) as own:
                    own.sendall((right % "data").encode())
                    assert own.recv(12) == b"HTTP/1.1 200"
                waits.append(time.monotonic() - since)
        found |= {
            "answers": answers,
            "own_wait_s_median_max": [np.median(waits), max(waits)],
        }
        found["page_MB_before_after"] = [before, memory([served])]
        process.send_signal(2)
        assert process.stdout is not None
        found["loop"] = counted(process.stdout.read())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["live", "hour", "strangers"])
    parser.add_argument("--seconds", type=float, default=600)
    parser.add_argument("--hours", type=float, default=1)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--requests", type=int, default=10_000)
    given = parser.parse_args()
    found = {
        "live": lambda: live(given.seconds),
        "hour": lambda: hour(given.hours, given.folder),
        "strangers": lambda: strangers(given.requests),
    }[given.what]()
    print(json.dumps({"cores": os.cpu_count(), **found}, indent=1))


if __name__ == "__main__":
    main()

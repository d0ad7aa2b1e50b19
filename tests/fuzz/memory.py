"""Memory of `record` while its rig floods it with junk and begins anew, for minutes.

    python tests/fuzz/memory.py [--minutes 30] [--rate 3000] [--every 20]

A virtual rig sends a third of its slots broken, a tenth out of order, and is killed and
started again; the recorder's files are short. Prints the resident memory of the command
and of its recorder, MB, once a minute.
"""

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tomojax.hardware.sources.virtual_rig import write_scene

COMMAND = "import sys; from tomojax.cli import main; sys.argv[0] = 'tomojax'; main()"


def resident(process: int) -> float:
    """MB; 0 where it has ended."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def children(process: int) -> list[int]:
    found = Path(f"/proc/{process}/task/{process}/children").read_text()
    return [int(word) for word in found.split()]


def rig(scene: Path, port: int, rate: float) -> subprocess.Popen:
    words = ["--link", "udp", "--port", port, "--rate", rate, "--corrupt", 0.3]
    words += ["--reorder", 0.1, "--loss", 0.05]
    command = [sys.executable, "-m", "tomojax.hardware.sources.virtual", scene, *words]
    return subprocess.Popen([*map(str, command)], stdout=subprocess.DEVNULL)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--rate", type=float, default=3000.0)
    parser.add_argument("--every", type=float, default=20.0, help="s between restarts")
    options = parser.parse_args()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = folder / "scene.npz"
        write_scene(scene, np.random.default_rng(0).uniform(0, 4, (20, 64, 64)), 0.05)
        source = rig(scene, port, options.rate)
        time.sleep(3)
        words = ["record", f"udp://127.0.0.1:{port}", "-o", str(folder / "rec.h5")]
        words += ["--seconds", str(60 * options.minutes), "--file-seconds", "60"]
        words += ["--view", "none"]
        record = subprocess.Popen([sys.executable, "-c", COMMAND, *words])
        began, restarts = time.monotonic(), 0
        told = began
        while record.poll() is None:
            time.sleep(options.every)
            source.kill()
            source.wait()
            source = rig(scene, port, options.rate)
            restarts += 1
            if record.poll() is None and time.monotonic() - told > 60:
                told = time.monotonic()
                sizes = [resident(p) for p in (record.pid, *children(record.pid))]
                minutes = (told - began) / 60
                each = ", ".join(f"{size:.1f}" for size in sizes)
                print(f"{minutes:5.1f} min, {restarts} restarts: {each} MB", flush=True)
        source.kill()
        source.wait()


if __name__ == "__main__":
    main()

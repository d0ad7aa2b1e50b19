"""A session: a source of slots, a ring, and the processes beside them."""

import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, ExitStack
from pathlib import Path
from typing import Any

from tomojax._require import require_library
from tomojax.cli import entry

# Seconds that a process beside the loop has to end: `shape` may be compiling.
_PATIENCE = 60.0

_NO_FORCE = (
    "no forces: they need --calibration with presses of known force "
    "(tomojax.calibration.calibrate_presses) and --radius"
)


class _Session:
    """A source and a ring, with the processes beside them."""

    def __init__(
        self,
        source: Any,
        ring: Any,
        recorder: Any,
        told: dict[str, Any],
        options: dict[str, Any],
    ):
        self.source, self.ring, self.recorder = source, ring, recorder
        self._told, self._beside = ring.beside(told), []
        self.words = sys.stdout  # where what is said at the end goes
        self._seconds, self._forces = options["seconds"], bool(options.get("radius"))
        self._view = _viewer(options["view"], options["rrd"], str(ring.path))
        if options["view"] == "web":
            recorded = ["--recorded"] if recorder is not None else []
            self._view += [self._told, *recorded]

    def beside(self, module: str, *words: str) -> None:
        """Starts a process beside the loop, and tells the process the ring and the rig."""
        name = f"tomojax.hardware.{module}"
        command = [sys.executable, "-m", name, str(self.ring.path), self._told, *words]
        # It has the cores that the loop leaves; its threads would not wait idly.
        flags = os.environ.get("XLA_FLAGS", "") + " --xla_cpu_multi_thread_eigen=false"
        given = {**os.environ, "XLA_FLAGS": flags}
        self._beside.append(_started(command, given))

    def run(
        self,
        step: Any,
        budget: float | None = None,
        tell: Callable[[float], None] = lambda seconds: None,
        images: bool = True,
    ) -> None:
        """Runs the loop until the time is up or Ctrl-C.

        The loop calls `tell` with the seconds since its start. Without `images`, a process
        beside the loop draws the view's image.
        """
        from tomojax.hardware import run

        view = _started(self._view) if self._view else None
        end = math.inf if self._seconds is None else time.perf_counter() + self._seconds
        began = time.perf_counter()

        def look() -> None:
            tell(time.perf_counter() - began)
            if self.recorder is not None:
                self.recorder.look()

        with entry.interrupts(own_end=True) as stop:
            until = lambda: stop.is_set() or time.perf_counter() > end  # noqa: E731
            try:
                run(
                    self.source,
                    step,
                    self.ring,
                    budget=budget,
                    until=until,
                    meanwhile=look,
                    images=images,
                )
            finally:
                self.ring.head["done"][...] = 1
                try:
                    self._close()
                finally:
                    for process in [view, *self._beside]:
                        if process is not None:
                            _wait(process)
        counted = self.ring.counted().items()
        seen = ", ".join(f"{n} {name}" for name, n in counted if n)
        if not self.ring.head["rows"]:
            raise ValueError(
                f"source: no slot was taken in {time.perf_counter() - began:.1f} s "
                f"({seen or 'nothing came'}); is this the rig, and does it send?"
            )
        print(seen or "no slots", file=self.words)
        if step is not None:
            self._tell()

    def _close(self) -> None:
        """Closes the recorder before any other process: slots reach the disk first."""
        if self.recorder is not None:
            self.recorder.close()
            if self.ring.head["rows"]:
                print(f"recording: {self.recorder.path}", file=self.words)

    def _tell(self) -> None:
        """Tells how soon slots were answered, and with which flags."""
        from tomojax.hardware.loop import flags_text, latency_text, load_text

        latency = latency_text(self.ring, 0.5, 0.99, 0.999, 0.9999)
        lines = [load_text(self.ring), latency, *flags_text(self.ring)]
        for line in [*lines, "" if self._forces else _NO_FORCE]:
            if line:
                print(line, file=self.words)


def _started(command: list[str], environment: Any = None) -> subprocess.Popen:
    """Starts a process that Ctrl-C in the terminal does not reach: the loop ends it."""
    group = 0 if os.name == "posix" else None
    return subprocess.Popen(command, env=environment, process_group=group)


def _wait(process: subprocess.Popen) -> None:
    """Waits until a process has ended, and ends a process that hangs."""
    words: Any = process.args
    name = " ".join([*words[2:3], *words[5:6]])[:80]
    try:
        if process.wait(_PATIENCE) < 0:
            print(f"{name}: was ended from outside", file=sys.stderr)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        print(f"{name}: did not end, and was ended", file=sys.stderr)


def _viewer(view: str, rrd: Path | None, ring: str) -> list[str]:
    """Returns the view's command, or an empty list without a view."""
    if view == "none":
        return []
    if view == "web":
        require_library("bokeh", "web")
        return [sys.executable, "-m", "tomojax.hardware.web.live", ring]
    if view == "terminal":
        return [sys.executable, "-m", "tomojax.hardware.loop.view", ring]
    require_library("rerun", "rerun")
    words = [] if rrd is None else ["--rrd", str(rrd)]
    return [sys.executable, "-m", "tomojax.hardware.loop.view_rerun", ring, *words]


@contextmanager
def session(
    source: str,
    out: Path | None,
    options: dict[str, Any],
    prepare: Callable[[Any], Any],
    check: Callable[[int, int], Any] = lambda electrodes, conditions: None,
):
    """Yields a session, and what `prepare` makes of the sensor before the source starts.

    A rig that already sends while a step is compiled would lose slots. `check` is told the
    numbers of electrodes and ground conditions before JAX is imported, which takes seconds.
    """
    names = "baud", "bind", "speed", "since", "until"
    given = {n: options[n] for n in names if options[n] is not None}
    if out is not None and out.exists():
        raise ValueError(f"{out}: is there; give another name")
    # What is not installed is told before anything is compiled.
    _viewer(options["view"], options["rrd"], "")
    from tomojax.hardware import open_source, SlotRing
    from tomojax.hardware.sources import OrderedSource, ReplaySource

    rig, _, electrodes = entry.sheet_of(options["like"])
    order = options.get("channels"), options.get("grounds")
    if rig is not None and rig.conditions is not None:
        if order[1] is not None:
            raise ValueError("--grounds: got an order, expected none with a table")
        given["conditions"] = rig.conditions

    def opened(where: str) -> Any:
        nonlocal rig
        slots = open_source(where, electrodes, **given)
        if isinstance(slots, ReplaySource):
            rig = slots.rig
        return slots if order == (None, None) else OrderedSource(slots, *order)

    slots = None if source == "virtual" else opened(source)
    if slots is None:
        check(electrodes, electrodes if rig is None else rig.condition_count)
    else:
        check(slots.electrodes, slots.condition_count)

    import numpy as np

    from tomojax.hardware.loop.recorder import Recorder
    from tomojax.recordings import attributes, Rig
    from tomojax.sensor import Sensor

    with ExitStack() as stack:
        sensor = Sensor.grid(dtype=np.float32, divisions=(32, 32))
        sensor = sensor if rig is None else rig.sensor()
        if slots is None:
            where, prepared = _virtual(sensor, prepare, stack)
            slots = opened(where)
        else:
            prepared = prepare(sensor)
        stack.enter_context(slots)
        ring = SlotRing.create(slots.electrodes, options.get("contacts") or 1)
        stack.callback(ring.remove)
        known = Rig.of(sensor, slots.rate) if rig is None else rig
        told, recorder = attributes(known, slots.scale, slots.offset), None
        if out is not None:
            recorder = Recorder(ring, out, told, options["file_seconds"])
            stack.callback(recorder.stop)
        yield _Session(slots, ring, recorder, told, options), prepared


def _virtual(
    sensor: Any, prepare: Callable[[Any], Any], stack: ExitStack
) -> tuple[str, Any]:
    """Starts a virtual rig, whose scene is drawn while `prepare` compiles."""
    from tomojax.hardware.loop import own_folder
    from tomojax.hardware.sources.virtual_rig import draw_eight, VirtualRig

    print("scenes for a virtual rig …", file=sys.stderr)
    with own_folder("tomojax-scene-") as folder, ThreadPoolExecutor(1) as beside:
        path = folder / "scene.npz"
        drawn = beside.submit(draw_eight, sensor, path)
        prepared = prepare(sensor)
        drawn.result()
        rig = stack.enter_context(VirtualRig(path, link="udp"))
    return rig.where, prepared

"""Commands on rigs: `tomojax record` and `tomojax live`."""

import json
import math
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable
from contextlib import contextmanager, ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

_FILE = click.Path(path_type=Path)


def _config(context: click.Context, parameter: Any, path: Path | None) -> None:
    """Values of a TOML file as defaults: the same keys as the options have names."""
    if path is None:
        return
    try:
        found = tomllib.loads(path.read_text())
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise click.BadParameter(f"{path}: {error}") from None
    keys = {}
    for key, value in found.items():
        name = key.replace("-", "_")
        known = {p.name for p in context.command.params} - {"config"}
        if name not in known:
            expected = ", ".join(sorted(n.replace("_", "-") for n in known if n))
            raise click.BadParameter(f"{path}: got {key}, expected one of {expected}")
        keys[name] = value
    context.default_map = {**(context.default_map or {}), **keys}


def _shared(command: Any) -> Any:
    """Options that both commands have."""
    for option in (
        click.option(
            "--config",
            type=_FILE,
            is_eager=True,
            expose_value=False,
            callback=_config,
            help="A TOML file with these options' values by name.",
        ),
        click.option(
            "--view",
            type=click.Choice(["terminal", "rerun", "none"]),
            default="terminal",
            show_default=True,
        ),
        click.option("--rrd", type=_FILE, help="With --view rerun: a file, no viewer."),
        click.option("--seconds", type=float, help="[default: until Ctrl-C]"),
        click.option(
            "--file-seconds",
            type=float,
            default=3600.0,
            show_default=True,
            help="A new file of the recording after so long.",
        ),
        click.option("--baud", type=int, help="Of a serial line. [default: 4000000]"),
        click.option(
            "--bind", help="Address to listen at over UDP. [default: 127.0.0.1, local]"
        ),
        click.option("--speed", type=float, help="Of a recording; 1 is its own."),
        click.option(
            "--like", type=_FILE, help="A recording of this rig: its sheet and electrodes."
        ),
    ):
        command = option(command)
    return click.argument("source")(command)


@click.command()
@_shared
@click.option("-o", "--out", type=_FILE, required=True, help="The recording.")
@click.option(
    "--pattern", default="all", show_default=True, help="Ground conditions, over and over."
)
@click.option(
    "--calibrate",
    is_flag=True,
    help="Show which squares of the sheet were touched, and calibrate at the end.",
)
def record(source: str, out: Path, pattern: str, calibrate: bool, **options: Any) -> None:
    """Record the slots of SOURCE: serial:PORT, udp://HOST:PORT, or virtual.

    A scan of the recording is one slot. What is on the disk stays readable whatever
    happens; a full disk or a crash begins a new file, OUT-1, OUT-2, ….
    With --calibrate rub the whole sheet with one finger: a map fills, lines say how well
    each part is known. Ctrl-C ends the rub; then OUT.calibration.json is made of it.
    """
    import numpy as np

    from tomojax.paper import pattern as patterns_pattern

    def grounds(sensor: Any) -> list[int]:
        return np.asarray(patterns_pattern(sensor, pattern)).tolist()

    made = out.with_name(out.stem + ".calibration.json")
    if calibrate and made.exists():
        raise ValueError(f"{made}: is there already; give another -o")
    with _session(source, out, options, grounds) as (session, asked):
        session.source.set_grounds(asked)
        if calibrate:
            session.beside("calibrating", str(out))
        session.run(None)
    if calibrate:
        _calibrated(out, made)


def _calibrated(rec: Path, made: Path) -> None:
    """Makes a calibration of a rub and prints how well it is known, as `calibrate` does."""
    from tomojax.calibration import calibrated_recording, text
    from tomojax.recordings import open_recording

    print("calibrating …", file=sys.stderr)
    with open_recording(rec) as recording:
        try:
            found = calibrated_recording(recording)
        except ValueError as error:
            raise ValueError(f"{rec}: {error}") from None
        print(text(recording.rig.sensor(), found))
    found.calibration.save(made)
    print(f"calibration: {made}")


@click.command()
@_shared
@click.option("--method", default="follow", show_default=True)
@click.option(
    "--policy",
    default="around_contacts",
    show_default=True,
    help="One of tomojax.POLICIES, or a table of `tomojax design --policy`.",
)
@click.option("--cheaper", help="A method that answers slots that are late.")
@click.option(
    "--budget", type=float, help="A slot that is older is late, s. [default: one slot]"
)
@click.option("--contacts", type=int, default=2, show_default=True, help="At most.")
@click.option("--calibration", type=_FILE, help="A calibration file of this rig.")
@click.option(
    "--adapt",
    is_flag=True,
    help="Follow zeros and gains that drift, slowly; with --record OUT their log is "
    "OUT.adapted.h5.",
)
@click.option("--record", "out", type=_FILE, help="Record here as well.")
@click.option(
    "--real-time",
    is_flag=True,
    help="One core, one function, no garbage collection, SCHED_FIFO.",
)
def live(source: str, method: str, policy: str, out: Path | None, **options: Any) -> None:
    """Contacts of the slots of SOURCE as they come, and its next grounds back.

    SOURCE: serial:PORT, udp://HOST:PORT, a recording, or virtual: a rig in a process.
    """
    from tomojax import Calibration, make_step
    from tomojax.hardware import real_time
    from tomojax.step import load_policy

    path = options["calibration"]
    calibration = None if path is None else Calibration.load(path)

    def compiled(sensor: Any) -> Any:
        print("compiling …", file=sys.stderr)
        own = policy.endswith(".npz")
        return make_step(
            sensor,
            method,
            policy,
            tables={policy: load_policy(policy, sensor)} if own else None,
            contacts=options["contacts"],
            cheaper=options["cheaper"],
            calibration=calibration,
        )

    with ExitStack() as stack:
        if options["real_time"]:
            allowed = stack.enter_context(real_time())
            print(f"real time: {', '.join(allowed)}", file=sys.stderr)
        session, step = stack.enter_context(_session(source, out, options, compiled))
        if options["adapt"]:
            log = "" if out is None else str(out.with_name(out.stem + ".adapted.h5"))
            session.beside("adapter", str(path or ""), log)
        session.run(step, options["budget"])


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
        self._told, self._beside = json.dumps(told), []
        self._seconds = options["seconds"]
        self._view = _viewer(options["view"], options["rrd"], str(ring.path))

    def beside(self, module: str, *words: str) -> None:
        """Starts a process beside the loop that is told of the ring and the rig."""
        name = f"tomojax.hardware.loop.{module}"
        command = [sys.executable, "-m", name, str(self.ring.path), self._told, *words]
        # It has the cores that the loop leaves; its threads would not wait idly.
        flags = os.environ.get("XLA_FLAGS", "") + " --xla_cpu_multi_thread_eigen=false"
        given = {**os.environ, "XLA_FLAGS": flags}
        self._beside.append(subprocess.Popen(command, env=given))

    def run(self, step: Any, budget: float | None = None) -> None:
        from tomojax.cli import _recordings
        from tomojax.hardware import run

        view = subprocess.Popen(self._view) if self._view else None
        end = math.inf if self._seconds is None else time.perf_counter() + self._seconds
        look = (lambda: None) if self.recorder is None else self.recorder.look
        with _recordings.interrupts() as stop:
            until = lambda: stop.is_set() or time.perf_counter() > end  # noqa: E731
            try:
                run(
                    self.source,
                    step,
                    self.ring,
                    budget=budget,
                    until=until,
                    meanwhile=look,
                )
            finally:
                self.ring.head["done"][...] = 1
                for process in [view, *self._beside]:
                    if process is not None:
                        process.wait()
                if self.recorder is not None:
                    self.recorder.close()
                    print(f"recording: {self.recorder.path}")
        self._tell(step is not None)

    def _tell(self, worked: bool) -> None:
        counted = {name: n for name, n in self.ring.counted().items() if n}
        print(", ".join(f"{n} {name}" for name, n in counted.items()) or "no slots")
        if worked:
            parts = self.ring.latency(0.5, 0.99, 0.999, 0.9999)
            told = (f"{1e6 * q:.0f}" for q in parts)
            print(
                f"last byte to ground command, 50, 99, 99.9, 99.99 %: {', '.join(told)} µs"
            )


def _viewer(view: str, rrd: Path | None, ring: str) -> list[str]:
    """The view's command, if any."""
    if view == "none":
        return []
    module = "view" if view == "terminal" else "view_rerun"
    if view == "rerun" and find_spec("rerun") is None:
        mend = "pip install 'tomojax[rerun]' brings it"
        raise ValueError(f"rerun is not installed; {mend}")
    words = [] if rrd is None or view != "rerun" else ["--rrd", str(rrd)]
    return [sys.executable, "-m", f"tomojax.hardware.loop.{module}", ring, *words]


@contextmanager
def _session(
    source: str, out: Path | None, options: dict[str, Any], prepare: Callable[[Any], Any]
):
    """A session and what `prepare` makes of the sensor before the source is started.

    A rig that sends already, while a step is compiled, would lose slots.
    """
    import numpy as np

    from tomojax import Sensor
    from tomojax.hardware import open_source, SlotRing
    from tomojax.hardware.loop.recorder import attributes, Recorder
    from tomojax.hardware.sources import ReplaySource
    from tomojax.hardware.sources.virtual_rig import draw_eight, VirtualRig
    from tomojax.recordings import open_recording, Rig

    names = "baud", "bind", "speed"
    given = {n: options[n] for n in names if options[n] is not None}
    if out is not None and out.exists():
        raise ValueError(f"{out}: is there; give another name")
    with ExitStack() as stack:
        rig = None
        if options["like"]:
            with open_recording(options["like"]) as recording:
                rig = recording.rig
        sensor = Sensor.grid(dtype=np.float32, divisions=(32, 32))
        sensor = sensor if rig is None else rig.sensor()
        if source == "virtual":
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            print("scenes for a virtual rig …", file=sys.stderr)
            draw_eight(sensor, folder / "scene.npz")
            rig_process = VirtualRig(folder / "scene.npz", link="udp")
            source = stack.enter_context(rig_process).where
        slots = open_source(source, sensor.electrode_count, **given)
        if isinstance(slots, ReplaySource):
            rig = slots.rig
            sensor = rig.sensor()
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

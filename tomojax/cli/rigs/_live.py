"""`tomojax live`: finds contacts in each slot of a rig as the slot comes."""

import json
import math
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from tomojax.cli import entry
from tomojax.cli.rigs._options import check_step, session_options, step_options
from tomojax.cli.rigs._session import session

# While JAX is imported and compiles, nothing else is seen.
_COMPILING = (
    "compiling the step: up to half a minute the first time; later runs start in seconds"
)


@click.command(cls=entry.Command)
@session_options
@step_options
@click.option(
    "--policy",
    help="Choose the next grounds by this policy: a name of tomojax.step.POLICIES, "
    "electrodes as 0,7,14, or a table of `tomojax design --policy`. [default: "
    "around_contacts; of a rig with a table of ground conditions all]",
)
@click.option(
    "--budget",
    type=entry.AMOUNT,
    help="A slot older than this is late, s. [default: one slot]",
)
@entry.calibration_option
@click.option(
    "--adapt",
    is_flag=True,
    help="Follow zeros and gains that drift slowly. If --record OUT is given, "
    "OUT.adapted.h5 logs them.",
)
@click.option(
    "--shapes",
    is_flag=True,
    help="Let a separate process draw the view's image by the method shape.",
)
@click.option(
    "--record",
    "out",
    type=entry.OutputFile("recording", also=(".adapted.h5",)),
    help="Write the slots to this recording as well. [default: no recording]",
)
@click.option(
    "--send",
    multiple=True,
    metavar="KIND:WHERE",
    help="Send contacts, touch-downs and lift-offs to udp://HOST:PORT, jsonl:FILE (- is "
    "standard output), osc://HOST:PORT, lsl:NAME, foxglove:PORT or ros2:TOPIC. Add "
    "?rate=100 for at most 100 rows a second. May be repeated.",
)
@click.option(
    "--radius",
    type=entry.AMOUNT,
    help="Radius of the tip that presses, m. --send then includes forces. Needs a "
    "--calibration with a law of pressure.",
)
@click.option(
    "--real-time",
    is_flag=True,
    help="Answer sooner: one core, one compiled function, no garbage collection, "
    "SCHED_FIFO where the system allows.",
)
def live(
    source: str, method: str, policy: str | None, out: Path | None, **options: Any
) -> None:
    """Find the contacts in each slot of SOURCE as the slot comes.

    SOURCE is serial:PORT, udp://HOST:PORT, ni:INPUTS,LINES, a recording, or virtual, a
    simulated rig. The command sends the next grounds back to SOURCE.
    """
    from tomojax.hardware.sinks import check_all

    asked = policy or "around_contacts"
    own = asked.endswith(".npz")
    check_step(method, options["cheaper"], (asked,))
    sinks = check_all(options["send"], out)
    # What is read line by line has no pictures of a terminal in between.
    lines = any((one.kind, one.path) == ("jsonl", "-") for one in sinks)
    if lines and options["view"] != "none":
        raise ValueError("--send jsonl:-: got a view as well, expected --view none")
    path, calibration, law = options["calibration"], None, None

    def check(electrodes: int, conditions: int) -> None:
        nonlocal calibration, law
        if not own:
            entry.ground_numbers("--policy", asked, conditions)
        if path is not None:
            from tomojax.sensor import Calibration

            calibration = Calibration.load(path, electrodes)
        law = _law(calibration, options["radius"])
        print(_COMPILING, file=sys.stderr)

    def compiled(sensor: Any) -> Any:
        import numpy as np

        from tomojax.step import load_policy, make_step

        table = policy is None and sensor.conditions is not None
        step = make_step(
            sensor,
            method,
            "all" if table else asked,
            tables={asked: load_policy(asked, sensor)} if own else None,
            contacts=options["contacts"],
            cheaper=options["cheaper"],
            calibration=calibration,
        )
        # The view's image is compiled here as well: in the loop slots would wait for it.
        if not options["shapes"]:
            np.asarray(step.image(step.state))
        return step

    with ExitStack() as stack:
        if options["real_time"]:
            from tomojax.hardware import real_time

            allowed = stack.enter_context(real_time())
            print(f"real time: {', '.join(allowed)}", file=sys.stderr)
        opened, step = stack.enter_context(session(source, out, options, compiled, check))
        if options["adapt"]:
            log = "" if out is None else str(out.with_name(out.stem + ".adapted.h5"))
            opened.beside("loop.adapter", str(path or ""), log)
        if options["shapes"]:
            opened.beside("loop.drawing", str(path or ""))
        for name in options["send"]:
            opened.beside("sinks.run", name, "--force", json.dumps(law))
        opened.words = sys.stderr if lines else sys.stdout
        opened.run(step, options["budget"], images=not options["shapes"])


def _law(calibration: Any, radius: float | None) -> tuple | None:
    """Returns what turns conductances into forces: a law, an area, m², and hysteresis."""
    if radius is None:
        return None
    if calibration is None or calibration.pressure is None:
        raise ValueError(
            "--radius: got no law of pressure, expected --calibration with one"
        )
    return calibration.pressure, math.pi * radius**2, calibration.hysteresis

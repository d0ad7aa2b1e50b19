"""Commands of `tomojax`, on click. Each command imports what it needs when it runs."""

import os
import sys

import click

from tomojax.cli import entry
from tomojax.cli._design import design
from tomojax.cli._studies import studies
from tomojax.cli._table1 import table1
from tomojax.cli.compiled import keep_compiled
from tomojax.cli.demo import demo
from tomojax.cli.recordings import info, reconstruct, repair
from tomojax.cli.results import export, track, view
from tomojax.cli.rigs import calibrate, check, compile_step, live, record


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="tomojax")
@click.option(
    "--no-cache",
    is_flag=True,
    envvar="TOMOJAX_NO_CACHE",
    show_envvar=True,
    help="Compile every program anew; keep no compiled programs in the cache folder.",
)
@click.pass_context
def app(context: click.Context, no_cache: bool) -> None:
    """Differentiable reconstruction for tomographic tactile sensors."""
    # The frontier reports how long programs compile, and the peers use NumPy's threads.
    if context.invoked_subcommand == "frontier":
        return
    # JAX calls LAPACK in SciPy's OpenBLAS. Its threads wait in a loop for each other: on
    # a machine with other work they take turns with that work, and table1 took 14 times
    # as long. JAX has threads of its own. NumPy and SciPy read this as they are imported,
    # so no command module imports them at its top. OpenBLAS takes OMP_NUM_THREADS for the
    # other two: a user who has set any of them has decided.
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    if not any(name in os.environ for name in names):
        os.environ.update(dict.fromkeys(names, "1"))
    if no_cache:
        os.environ["TOMOJAX_STEPS"] = ""
    else:
        keep_compiled()


for command in (
    demo,
    table1,
    reconstruct,
    info,
    repair,
    check,
    calibrate,
    track,
    export,
    view,
    record,
    live,
    compile_step,
    design,
    *studies(),
):
    app.add_command(command)


def run() -> None:
    """Runs `app`; an error is one line on standard error, and its exit status is 2."""
    with entry.listening(entry.stopped):
        _run()


def _run() -> None:
    try:
        status = app(standalone_mode=False)
        sys.stdout.flush()  # a full disk or a closed pipe is told here
    except (click.exceptions.Abort, KeyboardInterrupt):
        print(f"\n{entry.stopped()}", file=sys.stderr)
        raise SystemExit(entry.STOPPED) from None
    except click.ClickException as error:
        print(f"tomojax: {error.format_message()}", file=sys.stderr)
        raise SystemExit(2) from None
    except (OSError, ValueError) as error:
        print(f"tomojax: {' '.join(str(error).splitlines())}", file=sys.stderr)
        raise SystemExit(2) from None
    raise SystemExit(status or 0)

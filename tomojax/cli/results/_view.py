"""`tomojax view`: shows results in a page of the browser."""

import math
import time
import webbrowser
from pathlib import Path

import click

from tomojax._require import require_library
from tomojax.cli import entry


@click.command(cls=entry.Command)
@click.argument("results", type=entry.InputFile())
@click.option(
    "--recording",
    "rec",
    type=entry.InputFile(),
    help="Show voltages of this recording. [default: the results' own, if it is beside "
    "them]",
)
@entry.stretch_options
@click.option("--open", "opened", is_flag=True, help="Open the page in the browser.")
@click.option(
    "--seconds", type=entry.AMOUNT, help="Show for this time, s. [default: until Ctrl-C]"
)
def view(
    results: Path,
    rec: Path | None,
    since: float | None,
    until: float | None,
    opened: bool,
    seconds: float | None,
) -> None:
    """Show RESULTS in a page of the browser, on this machine alone.

    The printed address has a secret. Whoever has the address sees the page while the
    command runs.
    """
    require_library("bokeh", "web")
    from tomojax.cli.results._shown import ShownResults
    from tomojax.hardware.web import Pages, quiet, serve
    from tomojax.results.loading import attributes

    asked = rec is not None
    if not asked:
        told = str(attributes(results).get("recording", ""))
        beside = results.with_name(Path(told).name or "none")
        rec = beside if beside.is_file() and told == beside.name else None
    shown = ShownResults(results, since, until, rec, asked)
    quiet()
    end = math.inf if seconds is None else time.monotonic() + seconds

    def tell(url: str) -> None:
        print(f"page: {url}", flush=True)
        if opened:
            webbrowser.open(url)

    with entry.interrupts(own_end=True) as stop:
        over = lambda: stop.is_set() or time.monotonic() > end  # noqa: E731
        serve(Pages(shown.document(), shown.answer), tell, until=over)

"""The command line. Bad input is one line on standard error and exit status 2."""

import sys


def main() -> None:
    """Entry point of `tomojax`."""
    try:
        from tomojax.cli import app
    except ModuleNotFoundError as error:
        missing = error.name
        print(
            f"tomojax: {missing} is not installed; pip install 'tomojax[app]' brings it",
            file=sys.stderr,
        )
        raise SystemExit(2) from None
    app.run()

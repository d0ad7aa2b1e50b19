"""The command line. Bad input gives one line on standard error and exit status 2."""

import sys


def main() -> None:
    """Runs the program `tomojax`."""
    try:
        from tomojax.cli import app

        app.run()
    except ModuleNotFoundError as error:
        missing = error.name
        if missing is None or missing.startswith("tomojax"):
            raise  # a mistake of ours, which no package mends
        print(
            f"tomojax: {missing} is not installed; pip install 'tomojax[app]' brings it",
            file=sys.stderr,
        )
        raise SystemExit(2) from None
    except KeyboardInterrupt:  # while the commands themselves are imported
        print("\ntomojax: stopped", file=sys.stderr)
        raise SystemExit(130) from None

"""What a command loads before it works, and where compiled programs are kept."""

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import recordings
from click.testing import CliRunner

import tomojax as tx
from tomojax.cli import app, compiled, entry

# One process runs all commands, and tells of each: its status, what it said, what the
# process has imported so far, and what other processes would inherit.
_COMMANDS = """
import contextlib, io, json, os, sys
from tomojax.cli import main

for words in json.loads(sys.argv.pop()):
    sys.argv[1:] = words.split()
    said, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(errors):
        try:
            main()
        except SystemExit as stop:
            status = stop.code
    loaded = sorted({m.split(".")[0] for m in sys.modules})
    told = [status, said.getvalue(), errors.getvalue(), loaded, dict(os.environ)]
    print(json.dumps(told))
"""
_HEAVY = {"jax", "jaxlib", "scipy", "matplotlib"}
_LIGHT = _HEAVY | {"numpy", "h5py"}
_HELP = ("--help", "--version", "--wrong")

_MISTAKES = [
    ("reconstruct rec.h5 --method magic", "--method: got 'magic', expected one of auto"),
    ("reconstruct none.h5", "none.h5: no such file"),
    ("reconstruct text.h5", "text.h5: "),
    ("reconstruct rec.h5 -o there.h5", "there.h5: got a file, expected a new name"),
    ("reconstruct rec.h5 --picture a.txt", "a.txt: got '.txt', expected a name with"),
    ("reconstruct rec.h5 --from 99", "from: got 99 s, expected a stretch of the file"),
    ("reconstruct rec.h5 --calibration none.json", "none.json: no such file"),
    ("calibrate text.h5", "text.h5: "),
    ("check text.h5", "text.h5: "),
    ("track text.h5", "text.h5: "),
    ("live virtual --method magic", "--method: got 'magic', expected one of follow"),
    ("live virtual --policy magic", "--policy: got 'magic', expected one of all"),
    ("live virtual --policy 0,64", "expected electrodes from 0 to 63"),
    ("live virtual --policy none.npz", "none.npz: no such file"),
    ("live usb:3", "source: got 'usb:3', expected serial:PORT"),
    ("live none.h5", "none.h5: no such file"),
    ("live virtual --send smoke:3", "send: got 'smoke:3', expected one of udp"),
    ("record virtual -o a.h5 --pattern around", "expected one of all, boundary"),
    ("record virtual -o a.h5 --pattern 0,64", "expected electrodes from 0 to 63"),
    ("record virtual -o rec.h5", "rec.h5: is there"),
    ("design --region 0 0 900 9", "--region: got 0, 0, 900, 9, expected on the sheet"),
    ("design --grounds 64", "--grounds: got '64', expected electrodes from 0 to 63"),
]


def process(
    tmp_path: Path, code: str, *arguments: object, cwd: Path | None = None
) -> subprocess.CompletedProcess:
    """Runs `code` with an empty cache folder that is the user's, and without settings."""
    set_by_us = ("JAX_", "TF_CPP", "OPENBLAS", "OMP_", "MKL_", "TOMOJAX")
    own = {k: v for k, v in os.environ.items() if not k.startswith(set_by_us)}
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        env=own | {"XDG_CACHE_HOME": str(tmp_path / "cache")},
        cwd=cwd,
    )


@pytest.fixture(scope="module")
def ran(tmp_path_factory) -> dict[str, list]:
    """What is told of each command; those that import least come first."""
    folder = tmp_path_factory.mktemp("commands")
    recordings.write(folder / "rec.h5", recordings.touched(scans=3)[0])
    (folder / "text.h5").write_text("volts")
    (folder / "there.h5").write_text("results")
    words = [*_HELP, *(words for words, _ in _MISTAKES), "info rec.h5"]
    run = process(folder, _COMMANDS, json.dumps(words), cwd=folder)
    assert run.returncode == 0, run.stderr
    return dict(zip(words, map(json.loads, run.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("option", _HELP)
def test_nothing_heavy_is_loaded_to_say_what_there_is(ran, option) -> None:
    status, _, _, loaded, _ = ran[option]
    assert not _LIGHT & set(loaded)
    assert status == (2 if option == "--wrong" else 0)


def test_info_loads_no_jax_and_sets_the_cache(ran) -> None:
    _, said, errors, loaded, settings = ran["info rec.h5"]
    assert "can be read" in said, errors
    assert "numpy" in loaded and not _HEAVY & set(loaded)
    folder = Path(settings["JAX_COMPILATION_CACHE_DIR"])
    assert folder.parent == Path(settings["XDG_CACHE_HOME"]) / "tomojax"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert settings["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] == "0"
    assert settings["OPENBLAS_NUM_THREADS"] == "1"


@pytest.mark.parametrize("words, told", _MISTAKES)
def test_mistakes_are_told_before_jax_is_imported(ran, words, told) -> None:
    """So they are told in under a second."""
    status, _, errors, loaded, _ = ran[words]
    assert status == 2 and told in errors, errors
    assert len(errors.strip().splitlines()) == 1
    assert not {"jax", "scipy", "matplotlib"} & set(loaded)


def test_names_of_commands_are_those_of_the_rooms() -> None:
    """Commands know them without importing a room."""
    assert entry.METHODS == tuple(tx.methods.METHODS)
    assert set(entry.POLICIES) == set(tx.step.POLICIES)
    assert set(entry.FIXED) == set(tx.step.POLICIES) - {
        *tx.step.ADAPTIVE,
        "around_contacts",
        "information",
    }
    sensor = tx.Sensor.grid()
    assert entry.sheet_of(None) == (None, entry.SIZE, sensor.electrode_count)
    np.testing.assert_allclose(entry.SIZE, sensor.size)


def test_programs_are_kept_and_loaded_without_a_word(tmp_path) -> None:
    code = """
from tomojax.cli.compiled import keep_compiled
keep_compiled()
import jax, jax.numpy as jnp
print(jax.jit(lambda x: jnp.sin(x).sum())(jnp.arange(4.0)))
"""
    first = process(tmp_path, code)
    programs = sorted((tmp_path / "cache").glob("tomojax/compiled-*/*"))
    again = process(tmp_path, code)
    assert first.stdout == again.stdout and first.stderr == again.stderr == ""
    assert programs == sorted((tmp_path / "cache").glob("tomojax/compiled-*/*"))
    assert programs


@pytest.fixture
def environment(monkeypatch, tmp_path) -> dict[str, str]:
    """Stands for `os.environ`, of a user who has set nothing but the cache folder."""
    settings = {"PATH": os.environ["PATH"], "XDG_CACHE_HOME": str(tmp_path)}
    monkeypatch.setattr(os, "environ", settings)
    return settings


@pytest.mark.parametrize(
    ("arguments", "more", "kept", "threads"),
    [
        (["info", "absent"], {}, True, "1"),
        (["--no-cache", "info", "absent"], {}, False, "1"),
        (["info", "absent"], {"TOMOJAX_NO_CACHE": "1"}, False, "1"),
        (["info", "absent"], {"OPENBLAS_NUM_THREADS": "4"}, True, "4"),
        (["frontier", "--help"], {}, False, None),  # what compiles is timed there
    ],
)
def test_options_of_the_cache(environment, arguments, more, kept, threads) -> None:
    environment |= more
    CliRunner().invoke(app.app, arguments)
    assert ("JAX_COMPILATION_CACHE_DIR" in environment) == kept
    assert environment.get("OPENBLAS_NUM_THREADS") == threads


def test_settings_of_the_user_stay(environment, tmp_path) -> None:
    environment["JAX_COMPILATION_CACHE_DIR"] = "mine"
    before = dict(environment)
    compiled.keep_compiled()
    assert environment == before and not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_left(environment, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    environment["XDG_CACHE_HOME"] = str(tmp_path / "file")
    before = dict(environment)
    compiled.keep_compiled()
    assert environment == before


def test_a_folder_that_others_can_write_is_not_used(environment, capsys) -> None:
    compiled.keep_compiled()
    folder = Path(environment.pop("JAX_COMPILATION_CACHE_DIR"))
    assert environment.pop("TOMOJAX_PROGRAMS") == str(folder)
    assert folder.stat().st_mode & 0o777 == 0o700 and not capsys.readouterr().err
    folder.chmod(0o770)  # what lies there may be anybody's
    compiled.keep_compiled()
    assert not {"JAX_COMPILATION_CACHE_DIR", "TOMOJAX_PROGRAMS"} & environment.keys()
    assert "others own it or can write it" in capsys.readouterr().err


def test_a_program_that_was_cut_short_goes(environment, monkeypatch) -> None:
    """JAX warns of it each time, and writes no other in its place."""
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    compiled.keep_compiled()
    folder = Path(environment["JAX_COMPILATION_CACHE_DIR"])
    for name in ("jit_one-12-cache", "jit_one_more-34-cache"):
        (folder / name).write_text("cut")
    text = "Error reading persistent compilation cache entry for 'jit_one': error: -5"
    warnings.showwarning(UserWarning(text), UserWarning, "compiler.py", 783)
    assert [path.name for path in folder.iterdir()] == ["jit_one_more-34-cache"]


def test_the_programs_used_longest_ago_go_first(environment, tmp_path, monkeypatch) -> None:
    limit = 2500
    times = {"a": 30, "b": 10, "c": 20, "d": 40}
    for name, seconds in times.items():
        path = tmp_path / "tomojax" / f"compiled-{name}" / "program"
        path.parent.mkdir(parents=True)
        path.write_bytes(np.zeros(1000, np.uint8))
        os.utime(path, (seconds, seconds))
    compiled.keep_compiled(limit=limit)
    left = {path.parent.name[-1] for path in tmp_path.glob("tomojax/*/program")}
    assert left == {"a", "d"}

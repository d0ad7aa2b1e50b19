"""The command line as its user meets it."""

import subprocess
import sys

import pytest
from click.testing import CliRunner

from tomojax import _app


def test_demo_prints_and_draws(tmp_path) -> None:
    result = CliRunner().invoke(_app.app, ["demo", "--out", str(tmp_path / "pictures")])
    assert result.exit_code == 0, result.output
    assert "64 electrodes" in result.output
    assert (tmp_path / "pictures" / "voltages.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    "arguments, word", [(["paint"], "paint"), (["demo", "--out"], "--out")]
)
def test_mistakes_are_one_line_and_status_2(arguments, word) -> None:
    code = "from tomojax._cli import main; main()"
    run = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True
    )
    assert run.returncode == 2
    assert len(run.stderr.strip().splitlines()) == 1 and word in run.stderr


def test_output_folder_that_is_a_file(tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(sys, "argv", ["tomojax", "demo", "--out", str(tmp_path / "file")])
    with pytest.raises(SystemExit) as stop:
        _app.run()
    assert stop.value.code == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_missing_extra_is_named(monkeypatch, capsys) -> None:
    from tomojax import _cli

    monkeypatch.setitem(sys.modules, "click", None)
    monkeypatch.delitem(sys.modules, "tomojax._app", raising=False)
    monkeypatch.delattr("tomojax._app", raising=False)
    with pytest.raises(SystemExit) as stop:
        _cli.main()
    assert stop.value.code == 2
    assert "tomojax[app]" in capsys.readouterr().err

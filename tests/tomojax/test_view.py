"""`tomojax view`: a page of a results file; the time line in few numbers."""

import json
import subprocess
import sys
import urllib.request

import browser
import h5py
import numpy as np
import pytest
from click.testing import CliRunner

from tomojax.cli.app import app
from tomojax.hardware import web

pytest.importorskip("bokeh")
ROWS, M = 300_000, 64


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Five minutes of scans: a contact now and then, one flag in all of it, two marks."""
    path = tmp_path_factory.mktemp("view") / "push.results.h5"
    t = 5.0 + 1e-3 * np.arange(ROWS)
    count = ((t % 10) > 5).astype("u1")
    place = [0.08 + 0.05 * np.sin(t), 0.08 + 0.03 * np.sin(2 * t)]
    xy = np.where(count[:, None], np.stack(place, 1), np.nan)[:, None].astype("f4")
    strength = np.where(count, 2e-5, np.nan)[:, None].astype("f4")
    flags = np.zeros(ROWS, "u4")
    flags[123_457] = 16384
    strength[200_001] = 9e-5
    with h5py.File(path, "w") as file:
        file.attrs.update(
            schema="tomojax-results", schema_version=1, method="points", rate="scan",
            size=[0.16, 0.16], configuration="{}", recording="gone.h5",
            electrode_xy=0.01 + 0.02 * np.indices((8, 8)).reshape(2, -1).T,
            marks=json.dumps([[100.0, "the spanner falls"], [290.0, ""]]),
        )  # fmt: skip
        file["t"], file["contact_count"], file["contact_xy"] = t, count, xy
        file["contact_conductance"], file["flags"] = strength, flags
        file["residual"] = np.full(ROWS, 1e-3, "f4")
    return path


@pytest.fixture(scope="module")
def served(results):
    """Serves the page of the whole file; the address."""
    line = "from tomojax.cli import main; main()"
    command = [sys.executable, "-c", line, "view", str(results)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    yield browser.address(iter(process.stdout.readline, ""))
    process.terminate()
    process.wait(30)
    process.stdout.close()


def answer(url, asked=""):
    with urllib.request.urlopen(f"{url}data?{asked}", timeout=30) as said:
        return json.load(said)


def test_nothing_is_missed(served):
    url, said = served, {"thinned": "not yet"}
    while said["thinned"]:
        said = answer(url)
    sources = said["sources"]
    assert len(sources["line"]["t"]) <= 1000
    # One row among 300 000, on the line of the whole file.
    assert max(sources["line"]["high"]) == pytest.approx(90)
    doubt = sources["doubts"]
    assert doubt["name"] == ["HIGH_RESIDUAL"]
    assert doubt["t"][0] == pytest.approx(5 + 123.457, abs=1)
    assert said["names"] == ["HIGH_RESIDUAL", "marks"]
    assert [text.strip() for text in sources["marks"]["text"]] == [
        "the spanner falls",
        "marked",
    ]
    near = answer(url, "from=128.4&to=128.5&t=128.457")
    assert near["flags"][0][0] == "HIGH_RESIDUAL"
    assert near["sources"]["doubts"]["t"] == pytest.approx([128.457], abs=2e-3)
    assert near["sources"]["contacts"]["label"] == ["1: 20 µS"]
    for odd in ("t=nan", "t=inf&from=9&to=1", "from=x&to=&electrode=999", "t=-1e9"):
        assert answer(url, odd)["sources"]["line"]["t"]


def test_a_stretch(results, monkeypatch):
    """What the command would serve."""
    shown = []
    monkeypatch.setattr(web, "serve", lambda pages, tell, until: shown.append(pages))
    words = ["view", str(results), "--from", "100", "--to", "110"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    times = shown[0].answer({})["sources"]["line"]["t"]
    assert times[0] == pytest.approx(105) and times[-1] == pytest.approx(115, abs=0.1)


@pytest.mark.skipif(browser.found() is None, reason="needs Chromium")
def test_in_a_browser(served):
    pytest.importorskip("websockets")
    with browser.Browser() as page:
        page.go(served)
        page.wait("document.body && document.body.dataset.pictures > 0")
        page.value(
            "(() => { const s = document.getElementById('scrub'); s.value = 128.4571;"
            " s.dispatchEvent(new Event('input')); })()"
        )
        page.wait("document.getElementById('told').innerText.includes('row 123457')")
        assert "HIGH_RESIDUAL" in page.value("document.getElementById('flagged').innerText")
        assert page.said == []


@pytest.mark.parametrize(
    "words, told",
    [(["--from", "900"], "from: got 900 s"), (["--recording", "none.h5"], "none.h5")],
)
def test_bad_input_is_a_line(results, words, told):
    done = CliRunner().invoke(app, ["view", str(results), "--seconds", "1", *words])
    assert done.exit_code and told in f"{done.output}{done.exception}"


def test_no_results(tmp_path):
    path = tmp_path / "text.h5"
    path.write_text("no results")
    done = CliRunner().invoke(app, ["view", str(path), "--seconds", "1"])
    assert (
        done.exit_code and "no results of reconstruct" in f"{done.output}{done.exception}"
    )

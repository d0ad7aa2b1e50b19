"""Objects print in a few lines, and have a picture or a table for a notebook."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import recordings

import tomojax as tx
from tomojax import plots


def short(thing, *words) -> str:
    text = repr(thing)
    assert len(text.splitlines()) <= 5 and len(text) < 700, text
    # No array of more than a few numbers.
    assert not re.search(r"([-\d.e]+[,\s]+){20}", text), text
    for word in words:
        assert word in text, text
    return text


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid()


@pytest.fixture(scope="module")
def small():
    return tx.Sensor.grid(4, 4, divisions=(16, 16))


def test_sensors_and_scenes(sensor) -> None:
    short(sensor, "[160, 160] mm", "electrodes=64", "10000 Ω/sq", "4.5 V", "64 × 64")
    png = sensor._repr_png_()
    assert png is not None and png.startswith(b"\x89PNG")
    assert "float64" in repr(jax.eval_shape(lambda: sensor))  # without numbers
    jax.jit(lambda s: repr(s) and s.size)(sensor)
    disc = tx.Disc([0.03, 0.05], 0.006, 0.5)
    assert repr(disc) == "Disc(center=[0.03, 0.05], radius=0.006, conductance=0.5)"
    short(tx.Scene(*[disc] * 50), "Disc(center=[0.03", "50 shapes")
    short(tx.sensor.Mask(np.ones((40, 40))), "float64[40, 40]")
    short(tx.Converter(), "0.0003 V", "5 V")


def test_calibrations(rng) -> None:
    many = tuple(rng.normal(1, 1e-3, 64))
    known = tx.Calibration(gain=many, offset=many, deviation={"gain": 1e-3})
    short(known, " to ", "deviation=('gain',)")
    assert repr(tx.Calibration()) == "Calibration(gain=1, error=1, own=1)"


def test_results_of_one_frame_and_of_many(small) -> None:
    zero = jnp.zeros(())
    result = tx.paper.Reconstruction(
        jnp.zeros(512), zero + 0.1, zero + 3e-4, zero.astype(int)
    )
    assert repr(result) == (
        "Reconstruction(image=float64[512] in V, lam=0.1, residual=0.0003 V, flags=0)"
    )
    image = np.zeros((16, 16, 2))
    image[5:8, 9:12] = 1
    figures = tx.paper.figures_of_merit(small, image.ravel(), image.ravel())
    text = short(figures, "place=[32.5, 52.5] mm", "image_error=0,", "position_error=0 mm")
    assert re.search(r"half_width=[\d.]+ mm, half_area_radius=[\d.]+ mm, ", text)
    batch = tx.paper.figures_of_merit(small, np.ones((9, 512)), np.ones(512))
    short(batch, "half_width=float64[9] in mm")
    rows = tx.methods.empty_rows(500, {"C": 3, "nx": 32, "ny": 32})
    rows.contact_count[:7] = 1
    rows.flags[:3], rows.flags[3:5] = tx.Flag.HIGH_RESIDUAL, tx.Flag.NO_DATA
    assert repr(rows) == (
        "Rows(frames=500, contacts_at_most=3, with_contacts=7, in_doubt=3, "
        "without_answer=2, image=32 × 32)"
    )
    scenes = tx.design.SimulatedScenes(jnp.zeros((4, 2)), jnp.zeros((4, 16, 16)))
    short(scenes, "float64[4, 16, 16]")


def test_steps_and_designs(small) -> None:
    step = tx.make_step(small, "source", ["boundary", "all"], contacts=1, grid=8)
    short(step, "Source", "('boundary', 'all')", "electrodes=16")
    short(step.state, "numbers=float64[")
    state, out = step(step.state, np.full(16, 0.1), 0)
    short(out, "residual=", "ground=")
    grounds = np.arange(12)
    found = tx.design.Design(grounds, 3e-4, 2e-4, np.ones(64), 0.0, 0.0, 0.0, "m")
    told = ", ".join(map(str, range(12)))
    assert repr(found) == f"Design(grounds=[{told}], value=0.0003 m, bound=0.0002 m)"
    assert "<td>bound</td><td>0.0002 m</td>" in found._repr_html_()


def test_recordings(small) -> None:
    rig = tx.recordings.Rig.of(small)
    recording = tx.recordings.ArrayRecording(rig, np.zeros((300, 2, 16)), [0, 15])
    short(recording, "300 of 2 slots, 0 lost", "0.06 s", "electrodes=16")
    assert "<td>scans</td>" in recording._repr_html_()
    short(rig, "electrodes=16")


def test_no_picture_without_matplotlib(sensor, monkeypatch) -> None:
    import sys

    for name in list(sys.modules):
        if name.split(".")[0] == "matplotlib":
            monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert sensor._repr_png_() is None
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'tomojax\[app\]'"):
        plots.sheet(sensor)


def test_recordings_of_files(tmp_path) -> None:
    path = recordings.write(
        tmp_path / "r.h5", recordings.noise(np.random.default_rng(0), 40)
    )
    with tx.open_recording(path) as opened:
        short(opened, "r.h5", "40 of 2 slots", "electrodes=64")
        assert "r.h5" in opened._repr_html_()
    short(opened, "40 of 2 slots")  # nothing is read

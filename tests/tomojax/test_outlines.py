"""Outlines of images whose areas and moments are known."""

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import tomojax
from tomojax.cli import app
from tomojax.results import outlines_of, write_outlines

SIZE = np.array([0.16, 0.12])
SHAPE = (64, 48)


def image(distance):
    """Probabilities that are a half where `distance` (m, of places) is 0."""
    x, y = ((np.arange(n) + 0.5) / n * s for n, s in zip(SHAPE, SIZE))
    return 1 / (1 + np.exp(distance(x[:, None], y) / 0.001))


def ellipse(x, y, at=(0.07, 0.05), a=0.04, b=0.02, turn=0.5):
    """About the distance to an ellipse's rim, in its middle direction."""
    u, v = x - at[0], y - at[1]
    c, s = np.cos(turn), np.sin(turn)
    return (np.hypot((c * u + s * v) / a, (c * v - s * u) / b) - 1) * 0.02


def test_area_centroid_and_axes_of_an_ellipse():
    (found,) = outlines_of(image(ellipse), SIZE)
    assert found.area == pytest.approx(np.pi * 0.04 * 0.02, rel=0.02)
    np.testing.assert_allclose(found.centroid, [0.07, 0.05], atol=2e-4)
    np.testing.assert_allclose(found.axes, [0.04, 0.02], rtol=0.02)
    assert found.angle == pytest.approx(0.5, abs=0.01)
    assert np.isnan(found.conductance)


def test_a_ring_has_a_hole_and_objects_are_apart():
    def both(x, y):
        ring = abs(np.hypot(x - 0.05, y - 0.06) - 0.03) - 0.008
        return np.minimum(ring, np.hypot(x - 0.13, y - 0.06) - 0.012)

    g = 0.5 * image(both)
    ring, disc = outlines_of(image(both), SIZE, g)
    assert len(ring.rings) == 2 and len(disc.rings) == 1
    assert ring.area == pytest.approx(np.pi * (0.038**2 - 0.022**2), rel=0.03)
    assert disc.area == pytest.approx(np.pi * 0.012**2, rel=0.03)
    cell = SIZE.prod() / np.prod(SHAPE)
    assert ring.conductance + disc.conductance == pytest.approx(g.sum() * cell)
    assert disc.conductance == pytest.approx(0.5 * disc.area, rel=0.1)
    for one in (ring, disc):
        for line in one.rings:
            np.testing.assert_array_equal(line[0], line[-1])


def test_what_reaches_the_rim_of_the_sheet_is_closed_there():
    (found,) = outlines_of(image(lambda x, y: x + 0 * y - 0.04), SIZE)
    assert found.area == pytest.approx(0.04 * 0.12, rel=0.02)
    (whole,) = outlines_of(np.ones(SHAPE), SIZE)
    assert whole.area == pytest.approx(SIZE.prod())
    assert outlines_of(np.zeros(SHAPE), SIZE) == []


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="touch: got NaN"):
        outlines_of(np.full(SHAPE, np.nan), SIZE)
    with pytest.raises(ValueError, match="size"):
        outlines_of(np.zeros(SHAPE), (0.1, -0.1))


@pytest.fixture
def results(tmp_path):
    path = tmp_path / "rows.h5"
    touch = np.stack([image(ellipse), np.zeros(SHAPE)])
    with h5py.File(path, "w") as file:
        file.attrs.update(schema="tomojax-results", schema_version=1, size=SIZE)
        file["t"] = [0.5, 1.0]
        file["touch"], file["image"] = touch, 0.3 * touch
        file["contact_count"] = np.array([1, 0], np.uint8)
    return path


def test_geojson_and_svg(results, tmp_path):
    out = tmp_path / "a.geojson"
    assert write_outlines(results, out) == 1
    (feature,) = json.loads(out.read_text())["features"]
    assert feature["geometry"]["type"] == "Polygon"
    told = feature["properties"]
    assert told["row"] == 0 and told["t_s"] == 0.5
    assert told["area_m2"] == pytest.approx(np.pi * 0.04 * 0.02, rel=0.02)
    drawn = tmp_path / "a.svg"
    assert write_outlines(results, drawn) == 1
    root = ElementTree.parse(drawn).getroot()
    assert root.get("viewBox") == "0 0 160 120"
    with h5py.File(results, "a") as file:
        del file["touch"]
    with pytest.raises(ValueError, match="no image of touch"):
        write_outlines(results, out)


def test_the_command_says_what_it_cannot_do(tmp_path):
    """Before any work: another method, another ending."""
    demo = Path(tomojax.__file__).with_name("demo.h5")
    for words, text in (
        (["--outlines", "a.geojson"], "method 'shape'"),
        (["--method", "shape", "--no-images", "--outlines", "a.svg"], "images off"),
        (["--method", "shape", "--outlines", "a.txt"], "ending '.txt'"),
    ):
        given = ["reconstruct", str(demo), "-o", str(tmp_path / "o.h5"), *words]
        result = CliRunner().invoke(app.app, given)
        assert result.exit_code != 0
        assert text in str(result.exception) + result.output

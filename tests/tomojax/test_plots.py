"""Pictures: what is drawn where, in millimetres."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, Rectangle

import tomojax as tx
from tomojax import plots

DISC = tx.Disc([0.03, 0.05], 0.006, 1.0)


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(4, 4, divisions=(16, 16))


@pytest.fixture
def ax():
    return Figure(layout="constrained").add_subplot()


def test_a_sheet_with_its_electrodes(sensor, ax) -> None:
    assert plots.sheet(sensor, ax) is ax
    (sheet,) = [p for p in ax.patches if isinstance(p, Rectangle)]
    assert (sheet.get_width(), sheet.get_height()) == pytest.approx((80, 80))
    discs = [p for p in ax.patches if isinstance(p, Circle)]
    assert len(discs) == 16 and discs[0].radius == pytest.approx(2.5)
    assert np.allclose([p.center for p in discs], 1e3 * np.asarray(sensor.electrode_xy))
    assert [t.get_text() for t in ax.texts] == [str(k) for k in range(16)]
    assert ax.get_xlabel() == "x, mm" and ax.get_aspect() == 1


def test_an_image_lies_as_the_sheet_does(sensor, ax) -> None:
    g = tx.sensor.contact_conductance(sensor, DISC)
    plots.image(sensor, g, ax, unit="S")
    (drawn,) = ax.images
    pixels = np.asarray(drawn.get_array())  # rows are y
    y, x = np.unravel_index(pixels.argmax(), pixels.shape)
    assert abs(5 * x + 2.5 - 30) <= 2.6 and abs(5 * y + 2.5 - 50) <= 2.6
    assert list(drawn.get_extent()) == pytest.approx([0, 80, 0, 80])
    assert drawn.origin == "lower" and drawn.colorbar.ax.get_ylabel() == "S"
    # An image (nx, ny) of a method, of another number of pixels.
    plots.image(sensor, np.ones((8, 4)), ax, cmap="cividis")
    assert ax.images[-1].get_array().shape == (4, 8)
    for wrong in (np.ones(100), np.ones((2, 3, 4))):
        with pytest.raises(ValueError, match="image: got shape"):
            plots.image(sensor, wrong, ax)


def test_contacts_of_rows_of_steps_and_of_tracks(sensor, ax) -> None:
    rows = tx.methods.empty_rows(2, {"C": 3})
    rows.contact_xy[0, :2] = [[0.03, 0.05], [0.06, 0.02]]
    rows.contact_covariance[0, 0] = [4e-6, 1e-6, 0]
    plots.contacts(rows, ax)
    (line,) = ax.lines
    assert np.allclose(line.get_xydata(), [[30, 50], [60, 20]])
    (spread,) = [p for p in ax.patches if isinstance(p, Ellipse)]
    assert (spread.width, spread.height) == pytest.approx(
        (8, 4)
    ) and spread.angle % 180 == 0
    step = tx.make_step(sensor, "source", ["all"], contacts=1, grid=16)
    out = step(step.state, np.asarray(tx.voltages(sensor, DISC, [0])[0]), 0)[1]
    plots.contacts(out, ax, color="tab:blue")
    assert np.allclose(ax.lines[-1].get_xydata(), [[30, 50]], atol=6)
    with pytest.raises(ValueError, match="found: got int"):
        plots.contacts(3, ax)


def test_grounds_by_number_and_by_conductance(sensor, ax) -> None:
    plots.grounds(sensor, [0, 15], ax)
    partly = np.zeros((2, 16))
    partly[[0, 1], [0, 15]] = 0.25
    plots.grounds(sensor, partly, ax)
    for line in ax.lines:
        assert np.allclose(line.get_xydata(), [[10, 10], [70, 70]])
        assert line.get_marker() == "v"
    for wrong in ([16], [-1], [0.5]):
        with pytest.raises(ValueError, match="grounds: got"):
            plots.grounds(sensor, wrong, ax)


def test_truth_is_an_outline_for_each_shape(sensor, ax) -> None:
    mask = np.zeros((16, 16))
    mask[0, 0] = 1
    bar = tx.Bar([0.06, 0.02], 0.03, 0.006, 0.0, 5.0)
    plots.truth(sensor, tx.Scene(DISC, tx.Scene(bar), tx.sensor.Mask(mask)), ax)
    want = [[(24, 44), (36, 56)], [(45, 17), (75, 23)], [(0, 0), (5, 5)]]
    assert len(ax.collections) == 3
    for drawn, box in zip(ax.collections, want):
        low, high = drawn.get_datalim(ax.transData).get_points()
        assert np.allclose([low, high], box, atol=0.5)
        assert np.allclose(drawn.get_edgecolor(), [0, 0, 0, 1])


def test_layers_on_the_current_axes(sensor) -> None:
    import matplotlib.pyplot as plt

    with plt.rc_context({"backend": "agg"}):
        one = plots.image(sensor, np.ones(512))
        assert plots.sheet(sensor) is one and plots.truth(sensor, DISC) is one
        one.figure.canvas.draw()
        plt.close(one.figure)

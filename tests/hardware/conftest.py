"""Scenes for virtual rigs, measured by a rig model that is not ours."""

import numpy as np
import pytest
from rig import Rig

from tomojax.hardware.sources.virtual_rig import write_scene

PLACES = np.array([[0.05, 0.07], [0.055, 0.073], [0.112, 0.098], [0.108, 0.1]])


@pytest.fixture
def places():
    return PLACES


@pytest.fixture(scope="session")
def moments():
    """Voltages of a contact at each of PLACES, and of none."""
    rig = Rig(np.random.default_rng(21))
    some = [rig.scene((rig.disc(place, 0.006), 1e-4))[0] for place in PLACES]
    return np.stack([*some, rig.scene()[0]])


@pytest.fixture(scope="session")
def scene(tmp_path_factory, moments):
    """A contact at each of PLACES for 50 ms, then none for as long."""
    path = tmp_path_factory.mktemp("scene") / "scene.npz"
    write_scene(path, moments, 0.05)
    return path


@pytest.fixture(scope="session")
def held(tmp_path_factory, moments):
    """The same without the last: there is a contact whenever one looks."""
    path = tmp_path_factory.mktemp("held") / "scene.npz"
    write_scene(path, moments[:-1], 0.05)
    return path

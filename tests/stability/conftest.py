"""The sweeps' scenes are made once in a run: a minute of sparse LU for each method else."""

import pytest
import sweeps


@pytest.fixture(scope="session", autouse=True)
def _shared_scenes(tmp_path_factory, request):
    folder = tmp_path_factory.getbasetemp()
    if hasattr(request.config, "workerinput"):
        folder = folder.parent
    folder = folder / "scenes"
    folder.mkdir(exist_ok=True)
    sweeps.SHARED[:] = [folder]

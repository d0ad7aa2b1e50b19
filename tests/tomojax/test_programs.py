"""Programs that are kept between processes."""

import os
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

import tomojax as tx
from tomojax import _programs
from tomojax._programs import kept

traces = []


@kept
def scaled(tree: dict, factor: float) -> dict:
    traces.append(factor)
    return {"sum": factor * tree["x"].sum(), "none": None, "pair": (tree["x"], tree["n"])}


def forgotten() -> None:
    """Makes a process of this one that has called nothing yet."""
    _programs.forget()
    jax.clear_caches()


@pytest.fixture
def folder(request, monkeypatch, tmp_path):
    monkeypatch.setenv(_programs.FOLDER, str(tmp_path))
    # What JAX had kept of an earlier run could not be written again: it is made anew.
    kept = jax.config.jax_enable_compilation_cache

    def use(cache: bool) -> None:
        jax.config.update("jax_enable_compilation_cache", cache)
        compilation_cache.reset_cache()  # it asks once whether it is used

    use(False)
    request.addfinalizer(lambda: use(kept))
    traces.clear()
    forgotten()
    return tmp_path


def tree(n: int = 3, dtype=np.float64) -> dict:
    return {"x": jnp.arange(n, dtype=dtype), "n": 7}


def test_a_program_is_traced_once_for_all_processes(folder) -> None:
    first = scaled(tree(), 2.0)
    forgotten()
    again = scaled(tree(), 2.0)
    assert traces == [2.0] and len(list(folder.glob("*.program"))) == 1
    assert float(again["sum"]) == float(first["sum"]) == 6 and again["none"] is None
    assert int(again["pair"][1]) == 7


def test_a_folder_that_others_can_write_is_not_read(folder) -> None:
    scaled(tree(), 2.0)
    folder.chmod(0o777)  # the program may be anybody's
    forgotten()
    scaled(tree(), 2.0)
    assert traces == [2.0, 2.0]


def test_other_values_shapes_and_types_are_other_programs(folder) -> None:
    for args in ((tree(), 2.0), (tree(), 3.0), (tree(4), 2.0), (tree(3, np.float32), 2.0)):
        assert float(scaled(*args)["sum"]) == args[1] * float(args[0]["x"].sum())
    assert len(list(folder.glob("*.program"))) == len(traces) == 4


def test_other_source_is_another_program(folder, monkeypatch) -> None:
    scaled(tree(), 2.0)
    forgotten()
    monkeypatch.setattr(_programs, "source_digest", lambda: "another")
    scaled(tree(), 2.0)
    assert len(list(folder.glob("*.program"))) == 2


def test_a_file_that_was_cut_short_is_made_anew(folder) -> None:
    scaled(tree(), 2.0)
    (path,) = folder.glob("*.program")
    whole = path.read_bytes()
    path.write_bytes(whole[:1000])
    forgotten()
    assert float(scaled(tree(), 2.0)["sum"]) == 6
    assert len(traces) == 2 and path.stat().st_size > 1000


def test_a_folder_that_cannot_be_written_keeps_nothing(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv(_programs.FOLDER, str(tmp_path / "absent"))
    forgotten()
    assert float(scaled(tree(), 2.0)["sum"]) == 6 and not os.listdir(tmp_path)


def test_what_is_begun_is_traced_once_and_told_of(folder) -> None:
    for environment in ({}, {_programs.FOLDER: ""}):
        with pytest.MonkeyPatch.context() as patch:
            for name, value in environment.items():
                patch.setenv(name, value)
            forgotten()
            traces.clear()
            shapes = scaled.begin(tree(), 2.0)
            assert shapes["none"] is None and shapes["sum"].shape == ()
            assert (shapes["pair"][0].shape, shapes["pair"][0].dtype) == ((3,), np.float64)
            assert float(scaled(tree(), 2.0)["sum"]) == 6 and traces == [2.0]


def test_what_does_not_compile_says_so_each_time(folder) -> None:
    @kept
    def broken(x):
        raise RuntimeError("as it is traced")

    for _ in range(2):
        with pytest.raises(RuntimeError, match="as it is traced"):
            broken(jnp.ones(3))


def test_transformations_go_through(folder) -> None:
    slope = jax.grad(lambda x: scaled({"x": x, "n": 7}, 2.0)["sum"])(jnp.ones(3))
    many = eqx.filter_vmap(lambda x: scaled({"x": x, "n": 7}, 2.0)["sum"])(jnp.ones((2, 3)))
    assert slope.tolist() == [2, 2, 2] and many.tolist() == [6, 6]
    assert not list(folder.glob("*.program"))


def test_a_process_that_lowers_nothing_has_lapack(tmp_path) -> None:
    """A program that is loaded calls LAPACK, which JAX looks for as it lowers."""
    code = """
import jax.numpy as jnp
from tomojax._programs import kept
@kept
def factor(a):
    return jnp.linalg.cholesky(a)
print(factor(2 * jnp.eye(40, dtype="float32"))[0, 0])
"""
    environment = os.environ | {_programs.FOLDER: str(tmp_path)}
    command = [sys.executable, "-c", code]
    for _ in range(2):
        run = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert run.returncode == 0 and run.stdout.startswith("1.41"), run.stderr
    assert len(list(tmp_path.glob("*.program"))) == 1


def test_a_value_is_made_once_for_all_processes(folder) -> None:
    tables = [tx.method(tx.Sensor.grid(4, 4, divisions=(16, 16)), grid=16)]
    assert len(list(folder.glob("*.value"))) == 1
    tables.append(tx.method(tx.Sensor.grid(4, 4, divisions=(16, 16)), grid=16))
    assert len(list(folder.glob("*.value"))) == 1
    assert eqx.tree_equal(*tables)
    tx.method(tx.Sensor.grid(4, 4, divisions=(16, 16), drive_voltage=4.0), grid=16)
    assert len(list(folder.glob("*.value"))) == 2

"""The wheel holds every package, and the list in pyproject.toml is the tree."""

import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def packages_in_tree() -> set[str]:
    places = {
        "tomojax": "tomojax",
        "kernels": "tomojax.kernels",
        "hardware": "tomojax.hardware",
    }
    found = set()
    for folder, name in places.items():
        for init in (ROOT / folder).rglob("__init__.py"):
            below = init.parent.relative_to(ROOT / folder).parts
            found.add(".".join([name, *below]))
    return found


def test_listed_packages_are_the_tree() -> None:
    config = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert set(config["packages"]) == packages_in_tree()
    assert {"tomojax.kernels", "tomojax.hardware"} <= set(config["package-dir"])


def built(out: Path, tree: Path) -> Path:
    """The wheel of a checkout, at a time that is told."""
    # The build backend is in the test environment: no network, no isolation.
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", out, tree]
    # A copy has no git to ask for the version.
    told = {"SETUPTOOLS_SCM_PRETEND_VERSION_FOR_TOMOJAX": "0.1.0"}
    given = {**os.environ, **told, "SOURCE_DATE_EPOCH": "1750000000"}
    subprocess.run(command, check=True, capture_output=True, env=given)
    (wheel,) = out.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    # setuptools packs what an older build of the checkout has left there.
    shutil.rmtree(ROOT / "build", ignore_errors=True)
    return built(tmp_path_factory.mktemp("wheel"), ROOT)


def contents(wheel: Path) -> list[tuple[str, int, int]]:
    """Name, checksum and mode of each file."""
    held = zipfile.ZipFile(wheel).infolist()
    return [(one.filename, one.CRC, one.external_attr >> 16) for one in held]


def test_another_checkout_gives_the_same_bytes(wheel, tmp_path) -> None:
    """In another folder, written at another time; modes of files are the umask's."""
    tree = tmp_path / "copy"
    tree.mkdir()
    for name in ("tomojax", "kernels", "hardware"):
        unbuilt = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, tree / name, ignore=unbuilt, copy_function=shutil.copy)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    other = built(tmp_path, tree)
    assert contents(other) == contents(wheel)
    # Not the bytes in an assertion: pytest takes an hour to show how they differ.
    same = other.read_bytes() == wheel.read_bytes()
    assert same


def test_wheel_holds_every_file(wheel, tmp_path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    for folder, inside in (
        ("tomojax", "tomojax"),
        ("kernels", "tomojax/kernels"),
        ("hardware", "tomojax/hardware"),
    ):
        for source in (ROOT / folder).rglob("*.py"):
            assert f"{inside}/{source.relative_to(ROOT / folder)}" in held
    assert {"tomojax/py.typed", "tomojax/demo.h5", "tomojax/demo_palm.h5"} <= held


def run_from(wheel: Path, folder: Path, *words: str) -> subprocess.CompletedProcess:
    """Runs Python apart from the checkout, on what the wheel alone holds."""
    zipfile.ZipFile(wheel).extractall(folder / "site")
    return subprocess.run(
        [sys.executable, "-P", *words],
        cwd=folder,
        env={"PYTHONPATH": str(folder / "site"), "PATH": ""},
        capture_output=True,
        text=True,
    )


def test_wheel_is_imported(wheel, tmp_path) -> None:
    check = "import tomojax.kernels as k, tomojax.hardware; print(k.__file__)"
    run = run_from(wheel, tmp_path, "-c", check)
    assert run.returncode == 0, run.stderr
    assert str(tmp_path / "site") in run.stdout


@pytest.mark.parametrize("name", ["frontier", "stability"])
def test_studies_ask_for_a_checkout(name, wheel, tmp_path) -> None:
    command = "from tomojax.cli import main; main()"
    run = run_from(wheel, tmp_path, "-c", command, name, "--quick", "--out", "here")
    told = f"tomojax: {name} needs a checkout of the repository\n"
    assert (run.returncode, run.stderr) == (2, told)

"""The wheel holds every package, and the list in pyproject.toml is the tree."""

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

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


def test_wheel_holds_every_file(tmp_path) -> None:
    # The build backend is in the test environment: no network, no isolation.
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation"]
    epoch = os.environ | {"SOURCE_DATE_EPOCH": "1767225600"}
    for folder in ("", "again"):
        subprocess.run(
            [*command, "-o", tmp_path / folder, ROOT],
            check=True,
            capture_output=True,
            env=epoch,
        )
    (wheel,) = tmp_path.glob("*.whl")
    # Whoever builds it gets the same bytes.
    assert (tmp_path / "again" / wheel.name).read_bytes() == wheel.read_bytes()
    held = set(zipfile.ZipFile(wheel).namelist())
    for folder, inside in (
        ("tomojax", "tomojax"),
        ("kernels", "tomojax/kernels"),
        ("hardware", "tomojax/hardware"),
    ):
        for source in (ROOT / folder).rglob("*.py"):
            assert f"{inside}/{source.relative_to(ROOT / folder)}" in held
    assert {"tomojax/py.typed", "tomojax/demo.h5", "tomojax/demo_shapes.npz"} <= held
    # Apart from the checkout, from the wheel alone.
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    check = "import tomojax.kernels as k, tomojax.hardware; print(k.__file__)"
    run = subprocess.run(
        [sys.executable, "-P", "-c", check],
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path / "site"), "PATH": ""},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    assert str(tmp_path / "site") in run.stdout

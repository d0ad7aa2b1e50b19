"""Each command without a package that it needs: one line that names it, and status 2.

A row: the module that is not there, the extra that brings it, the command's words. `{h5}`
is a recording, `{tdms}` one of LabVIEW's, `{out}` a name that is free. What a command
needs of several is told of the first.
"""

import subprocess
import sys
from pathlib import Path

import pytest
from withheld import environment

import tomojax

DEMO = Path(tomojax.__file__).with_name("demo.h5")

ROWS = [
    ("click", "app", "info {h5}"),
    ("h5py", "app", "info {h5}"),
    ("h5py", "app", "reconstruct {h5} -o {out}"),
    ("h5py", "app", "record udp://127.0.0.1:9 -o {out}"),
    ("matplotlib", "app", "demo"),
    ("distributed", "cluster", "reconstruct {h5} -o {out} --cluster tcp://127.0.0.1:9"),
    ("nptdms", "tdms", "info {tdms}"),
    ("serial", "serial", "record serial:/dev/null -o {out}"),
    ("cobs", "serial", "record serial:/dev/null -o {out}"),
    ("nidaqmx", "ni", "record ni:Dev1/ai0:63,Dev1/port0/line0:5 -o {out}"),
    ("rerun", "rerun", "live {h5} --view rerun"),
    ("bokeh", "web", "live {h5} --view web"),
    ("bokeh", "web", "view {h5}"),
    ("pyarrow", "parquet", "export {h5} --to parquet -o {out}"),
    ("h5netcdf", "netcdf", "export {h5} --to netcdf -o {out}"),
    ("mcap_ros2", "mcap", "export {h5} --to mcap -o {out}"),
    ("mcap", "mcap", "info {mcap}"),
    ("foxglove", "foxglove", "live {h5} --send foxglove:45999"),
    ("pylsl", "lsl", "live {h5} --send lsl:a"),
    ("pythonosc", "osc", "live {h5} --send osc://127.0.0.1:45999"),
]


@pytest.mark.parametrize("module, extra, words", ROWS)
def test_missing_package_is_one_line(module, extra, words, tmp_path):
    (tmp_path / "some.tdms").write_bytes(b"TDSm" + bytes(100))
    (tmp_path / "some.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    names = {"mcap": tmp_path / "some.mcap"}
    names |= {"h5": DEMO, "tdms": tmp_path / "some.tdms", "out": tmp_path / "out.h5"}
    run = subprocess.run(
        [sys.executable, "-c", "from tomojax.cli import main; main()"]
        + [word.format(**names) for word in words.split()],
        env=environment(tmp_path, [module]),
        capture_output=True,
        text=True,
        timeout=120,
    )
    lines = [line for line in run.stderr.splitlines() if line.strip()]
    told = f"{module} is not installed; pip install 'tomojax[{extra}]' brings it"
    assert run.returncode == 2 and len(lines) == 1 and told in lines[0], run.stderr
    assert not (tmp_path / "out.h5").exists()

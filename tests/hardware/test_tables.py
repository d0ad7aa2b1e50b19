"""Tables of ground conditions from the host to a virtual rig, and into a recording."""

from dataclasses import replace

import click.testing
import numpy as np
import pytest

import tomojax as tx
from tomojax.cli.app import app
from tomojax.hardware import open_source
from tomojax.hardware.loop.recorder import File
from tomojax.hardware.sources import check_source, OrderedSource, ReplaySource
from tomojax.hardware.sources.virtual_rig import VirtualRig, write_scene
from tomojax.recordings import attributes, open_recording, Rig

TABLE = np.zeros((6, 4))  # more rows than electrodes
TABLE[np.arange(6), [0, 0, 0, 1, 1, 2]] = 0.25
TABLE[np.arange(6), [1, 2, 3, 2, 3, 3]] = 0.25


@pytest.fixture(scope="module")
def paired(tmp_path_factory):
    """Codes tell the row and the electrode."""
    path = tmp_path_factory.mktemp("paired") / "scene.npz"
    write_scene(path, (np.arange(24).reshape(1, 6, 4) / 10), 1.0, TABLE)
    return path


@pytest.mark.parametrize("link", ["udp", "pty"])
def test_a_virtual_rig_takes_its_table(paired, link):
    with VirtualRig(paired, link=link, rate=1000, noise=0) as rig:
        source = open_source(rig.where, 4, conditions=TABLE)
        assert check_source(source, 0.5, grounds=[5, 2]) == []
        codes = np.zeros(4, np.int16)
        with OrderedSource(source, channels=[3, 2, 1, 0]) as ordered:
            ordered.set_grounds([5])
            seen = set()
            for _ in range(200):
                got = ordered.read(codes, 1.0)
                assert got is not None
                volts = source.scale * codes + source.offset
                expected = np.arange(4)[::-1] / 10 + 0.4 * got.ground
                np.testing.assert_allclose(volts, expected, atol=1e-3)
                seen.add(got.ground)
            assert got.ground == 5 and seen <= {0, 5, 2}


@pytest.mark.parametrize(
    ["table", "why"],
    [
        (TABLE[:5], "the rig took 0 of 5 ground conditions; has it room for them"),
        (2 * TABLE, "the rig took 0 of 6 ground conditions"),
        (None, "no rig answers within 0.5 s; is it switched on\\?"),
    ],
)
def test_another_table_is_one_sentence(paired, table, why, monkeypatch):
    monkeypatch.setattr("tomojax.hardware.sources._wire._NO_ANSWER", 0.5)
    with VirtualRig(paired, link="udp", rate=1000) as rig:
        given = {} if table is None else {"conditions": table}
        with pytest.raises(TimeoutError, match=why):
            open_source(rig.where, 4, **given).start()


def test_a_rig_without_tables_does_not_answer(scene, monkeypatch):
    monkeypatch.setattr("tomojax.hardware.sources._wire._NO_ANSWER", 0.5)
    with VirtualRig(scene, link="udp") as rig:
        source = open_source(rig.where, conditions=np.eye(64))
        with pytest.raises(TimeoutError, match="does it know tables of ground conditions"):
            source.start()


@pytest.fixture(scope="module")
def like(tmp_path_factory):
    """A recording of a disc with a table: two slots."""
    inner = [[0.05, 0.05], [0.03, 0.05], [0.07, 0.05], [0.05, 0.03], [0.05, 0.07]]
    sensor = tx.Sensor.disc(0.1, {"rim": 8, "points": inner}, dtype=np.float32)
    table = np.zeros((4, 13))
    for row, two in zip(table, [(0, 4), (1, 5), (2, 6), (3, 7)]):
        row[list(two)] = 0.25
    told = attributes(Rig.of(replace(sensor, conditions=table)), 5 / 32000, 0.0)
    path = tmp_path_factory.mktemp("like") / "like.h5"
    file = File(path, told, 13)
    rows = np.zeros(2, [("codes", "i2", 13), ("ground", "i2"), ("time", "f8")])
    rows["time"] = 0, 1e-4
    file.append(rows, np.zeros(2, int), 1e9)
    file.close()
    return path


def test_a_recording_has_the_grounds_of_its_table(like):
    with open_recording(like) as recording:
        source = ReplaySource(recording)
        assert source.condition_count == 4
        with pytest.raises(ValueError, match="grounds: got .*0 to 3"):
            source.set_grounds([4])


@pytest.mark.long
@pytest.mark.parametrize("command", ["record", "live"])
def test_a_session_with_a_table(command, like, tmp_path):
    """By --like, from the scene to the file; an order of ground lines has no meaning."""
    out = str(tmp_path / "rec.h5")
    words = [command, "virtual", "--like", str(like), "--view", "none", "--seconds", "1"]
    words += ["-o" if command == "record" else "--record", out]
    run = click.testing.CliRunner().invoke
    done = run(app, [*words, "--grounds", "0,1,2,3"])
    assert isinstance(done.exception, (ValueError, SystemExit)) and "--grounds" in (
        done.output + str(done.exception)
    )
    done = run(app, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    with open_recording(out) as recording:
        assert recording.rig.outline.kind == "disc"
        assert recording.rig.conditions.shape == (4, 13)
        chunk = recording.read(0, recording.scans)
        assert set(np.unique(chunk.grounds)) == {0, 1, 2, 3}

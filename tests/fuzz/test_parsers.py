"""An excerpt of the fuzzer of parsers, without coverage; `parsers.py` is the whole."""

import time

import click
import numpy as np
import parser_seeds
import parsers
import pytest

import tomojax as tx
from tomojax.cli.app import app
from tomojax.files import read_csv
from tomojax.hardware import sources


@pytest.mark.parametrize("name", parsers.TARGETS)
def test_a_good_value_or_one_line(name):
    target, rng = parsers.TARGETS[name], np.random.default_rng(0)
    good, found = target.seeds(), parsers.Findings(target)
    for data in good:
        found(data)
    for _ in range(200):
        found(parser_seeds.mutated(good, rng))
    assert not found.known


RIG = b'{"schema": "tomojax-calibration", "schema_version": 1, '


@pytest.mark.parametrize(
    "field",
    [
        b'"error": 1e300',  # infinite in float32
        b'"noise": 1e-310',  # 0 in float32
        b'"offset": null',
        b'"offset": true',
        b'"ground": "1.5"',
        b'"offset": 1' + b"0" * 400,
        b'"a\\nb": 1',
        b'"%s": 1' % (b"9" * 5000),
    ],
)
def test_calibrations_that_the_fuzzer_found(tmp_path, field):
    path = tmp_path / "rig.json"
    path.write_bytes(RIG + field + b"}")
    with pytest.raises(ValueError) as error:
        tx.Calibration.load(path)
    text = str(error.value)
    assert "\n" not in text and len(text) < 1000 and "rig.json: " in text


@pytest.mark.parametrize(
    "line",
    [
        "contacts = 2.5",
        "contacts = inf",
        "contacts = true",
        "baud = 0",
        "seconds = nan",
        "file-seconds = -1",
        "speed = 0",
        "budget = inf",
        "channels = [1.5, 0]",
        "grounds = [1e400]",
    ],
)
def test_options_that_the_fuzzer_found(tmp_path, line):
    (tmp_path / "rig.toml").write_text(line)
    words = ["virtual", "--config", str(tmp_path / "rig.toml")]
    with pytest.raises(click.BadParameter, match="expected") as error:
        app.commands["live"].make_context("live", words)
    assert "\n" not in error.value.format_message()


@pytest.mark.parametrize(
    "words",
    [["track", "r.h5", "--drift", "nan,0"], ["reconstruct", "r.h5", "--lam", "nan"]],
)
def test_numbers_of_other_commands(words):
    with pytest.raises(click.BadParameter, match="got .*nan"):
        app.commands[words[0]].make_context(*words[:1], words[1:])


def test_what_a_file_is_is_told_of_any_bytes(tmp_path):
    """A zip of a version that there is not: it is no table of ours, and is not replaced."""
    path = tmp_path / "table.npz"
    np.savez(path, table=[1], idle=[1])
    content = bytearray(path.read_bytes())
    content[content.index(b"PK\1\2") + 6] = 255
    path.write_bytes(content)
    with pytest.raises(ValueError, match="something else, expected a new name"):
        app.commands["design"].main(["--policy", str(path)], standalone_mode=False)


@pytest.mark.parametrize(
    "text, shape",
    [
        ("1,2\n", (1, 2)),
        ("0.1", (1, 1)),
        ("1;2;\n3;4;\n", (2, 2)),  # a separator ends each line
        ("1;2;\n3;4;5\n", (2, 3)),  # a value is missing
    ],
)
def test_a_text_of_few_lines_is_a_table(tmp_path, text, shape):
    (tmp_path / "xy.csv").write_text(text)
    assert read_csv(tmp_path / "xy.csv", "places").values.shape == shape


@pytest.mark.parametrize(
    "numbers", [(1e300, 1.0, 0.0), (1e4, 1e300, 0.0), (1e4, 1e-300, 0.0), (1e4, 1.0, 1e40)]
)
def test_rigs_that_cannot_be(numbers):
    """Times or voltages would be infinite, or all the same."""
    told = sources.pack_description(sources.Description(4, 1, 0, *numbers))

    class Says(sources.Link):
        def open(self): ...
        def send(self, message): ...
        def close(self): ...

        def receive(self, timeout):
            return [told], time.perf_counter()

    with pytest.raises(ValueError, match="^rate, scale, offset: got a rig with"):
        sources.WireSource(Says(), 4).start()


@pytest.mark.parametrize("where", ["serial:/" + "x" * 300, "udp://h:²", "ni:" + "x" * 5000])
def test_sources_that_the_fuzzer_found(where):
    with pytest.raises(ValueError, match="^source: .{1,400}$"):
        sources.open_source(where)

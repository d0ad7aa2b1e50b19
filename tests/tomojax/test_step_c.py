"""A step as C: the same answers as JAX's program, kept, and as a folder for others."""

import ctypes
import shutil
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import tomojax as tx
from tomojax import cli
from tomojax.native import compiler

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler is there")

POLICIES = ("around_contacts", "around", "all")
MADE = {
    "follow": {"contacts": 2},
    "source": {"contacts": 1, "grid": 8},
    "linear": {"contacts": 1, "grid": 8, "cheaper": "source"},
}


@pytest.fixture(scope="module", autouse=True)
def quick_compiler():
    """Optimises less: that takes a quarter of the time. `test_native` has all of it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O1")
        yield


@pytest.fixture(scope="module")
def sensor():
    return tx.Sensor.grid(4, 4, dtype=np.float32, divisions=(20, 20))


@pytest.fixture(scope="module")
def levels(sensor):
    """Volts of all grounds: of nothing, one contact, two and three."""
    discs = [tx.Disc(p, 0.005, 1.0) for p in ([0.03, 0.05], [0.06, 0.02], [0.05, 0.062])]
    some = [np.asarray(tx.voltages(sensor, tx.Scene(*discs[:n]))) for n in (1, 2, 3)]
    return [np.zeros((16, 16)), *some]


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, marks=pytest.mark.long) if name != "source" else name
        for name in MADE
    ],
)
def pair(request, sensor, tmp_path_factory):
    """A step as C and the same as JAX's program."""
    folder = tmp_path_factory.mktemp("steps")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TOMOJAX_STEPS", str(folder))
        made = [
            tx.make_step(sensor, request.param, POLICIES, native=n, **MADE[request.param])
            for n in (True, False)
        ]
    return made


@pytest.fixture(scope="module")
def written(sensor, tmp_path_factory):
    """The folder of a step."""
    folder = tmp_path_factory.mktemp("compiled") / "step"
    step = tx.make_step(sensor, "follow", POLICIES, contacts=1)
    name = tx.step.compile(step, folder)
    return folder, name, step


def slots(levels, count, seed=0):
    """Volts by ground, the ground that a slot says, slots lost, and whether hurried."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        volts = levels[k // 25 % len(levels)]

        def slot(ground, volts=volts, k=k):
            v = volts[ground] + rng.normal(0, 1e-3, volts.shape[1])
            lost, hurried = int(rng.integers(9) * (k % 31 == 0)), k % 7 == 0
            fault = k % 47 if k > 20 else -1
            if fault == 0:
                v[rng.integers(16)] = np.nan
            elif fault == 1:
                v[:] = 0
            elif fault == 2:
                v[3] = 40
            elif fault == 3:
                ground = int(rng.choice([-1, 16, 2**31 - 1]))
            elif fault == 4:
                v[rng.integers(16, size=12)] = np.inf
            elif fault == 5:
                v = rng.normal(0, 3, 16)
            return v.astype(np.float32), ground, lost, hurried

        yield slot


def test_it_answers_as_jax_does_from_the_same_state(pair, levels):
    as_c, as_jax = pair
    assert (as_c.native, as_jax.native) == (True, False)
    assert "runs_as=C" in repr(as_c) and "runs_as=JAX" in repr(as_jax)
    state, ground, apart, found, otherwise = as_jax.state, 0, [], 0, 0
    for policy in POLICIES:
        state = as_jax.switch(state, policy)
        # No more contacts than it finds: with one more it decides between bad answers.
        for slot in slots(levels[: 1 + as_c.contact_count], 250):
            given = slot(ground)
            after, mine = as_c(state, *given)
            state, theirs = as_jax(state, *given)
            answers = [
                (int(o.flags), int(o.ground), int(o.contacts.count)) for o in (mine, theirs)
            ]
            if answers[0] != answers[1]:  # a slot that lies between two decisions
                otherwise += 1
                ground = int(theirs.ground)
                continue
            n, found = int(theirs.contacts.count), found + int(theirs.contacts.count)
            # Contacts that are equally strong have no order.
            xy, other = (np.asarray(o.contacts.xy)[:n] for o in (mine, theirs))
            apart += np.linalg.norm(xy[:, None] - other, axis=2).min(1, initial=1).tolist()
            assert all(a.dtype == np.asarray(b).dtype for a, b in zip(after, state))
            ground = int(theirs.ground)
    assert found > 200 and otherwise <= 2
    assert np.quantile(apart, 0.9) < 1e-6 and np.quantile(apart, 0.99) < 1e-4
    image, other = as_c.image(after), np.asarray(as_jax.image(state))
    np.testing.assert_allclose(image, other, rtol=1e-3, atol=1e-3 * np.nanmax(abs(other)))


def test_its_own_states_go_on(pair, levels, tmp_path):
    step, _ = pair
    volts = np.stack([levels[1][0]] * 30 + [levels[0][0]] * 5).astype(np.float32)
    state, outs = step.state, []
    before = [a.copy() for a in state]
    for v in volts:
        state, out = step(state, v, 0)
        outs.append(out)
    assert all((a == b).all() for a, b in zip(before, step.state))
    last, rows = step.replay(step.state, volts, np.zeros(len(volts), int))
    assert all((a == b).all() for a, b in zip(last, state))
    assert [int(o.flags) for o in outs] == rows.flags.tolist()
    none, rows = step.replay(state, volts[:0], np.zeros(0, int))
    assert len(rows.flags) == 0 and all((a == b).all() for a, b in zip(none, state))
    step.save(tmp_path / "state.npz", state)
    again, out = step(step.load(tmp_path / "state.npz"), volts[0], 0)
    assert int(out.flags) == int(step(state, volts[0], 0)[1].flags)
    with pytest.raises(ValueError, match="state: got float32 .*, expected float32"):
        step((np.zeros(3, np.float32), state[1]), volts[0], 0)
    with pytest.raises(ValueError, match="voltages: got shape"):
        step(state, volts[0][:5], 0)


def test_threads_do_not_disturb_each_other(pair, levels):
    step, _ = pair
    volts = [np.tile(levels[n][0], (200, 1)).astype(np.float32) for n in (1, 2)]
    grounds = np.zeros(200, int)
    alone = [step.replay(step.state, v, grounds)[1].contacts.xy for v in volts]
    found = [[], []]

    def run(k):
        for _ in range(20):
            found[k].append(step.replay(step.state, volts[k], grounds)[1].contacts.xy)

    threads = [threading.Thread(target=run, args=(k,)) for k in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k in (0, 1):
        assert all(np.array_equal(xy, alone[k], equal_nan=True) for xy in found[k])


@pytest.mark.long
def test_it_is_kept_and_made_again_where_it_is_damaged(sensor, tmp_path, monkeypatch):
    monkeypatch.setenv("TOMOJAX_STEPS", str(tmp_path))
    make = lambda **more: tx.make_step(  # noqa: E731
        sensor, "source", ["all"], contacts=1, grid=8, native=True, **more
    )
    assert make().traces == 1
    kept = make()
    assert kept.native and kept.traces == 0  # nothing was traced
    (folder,) = tmp_path.iterdir()
    assert {p.name for p in folder.iterdir()} >= {"step.so", "step.tables", "about.json"}
    tables = (folder / "step.tables").read_bytes()
    (folder / "step.tables").unlink()
    (folder / "step.tables").write_bytes(tables[:-100])
    assert make().traces == 1 and make().traces == 0
    # Another calibration is another step of the same code, which is not compiled again.
    with monkeypatch.context() as patch:
        patch.delattr("tomojax.step.c._kept.compile_c")
        assert make(calibration=tx.Calibration(offset=np.full(16, 1e-3))).traces == 1
    assert len(list(tmp_path.iterdir())) == 2
    # What others can write would be run.
    tmp_path.chmod(0o777)
    assert make().traces == 1
    tmp_path.chmod(0o700)
    monkeypatch.setenv("TOMOJAX_STEPS", "")
    assert make().traces == 1


def test_where_nobody_asks(sensor, monkeypatch):
    make = lambda **more: tx.make_step(  # noqa: E731
        sensor, "source", ["all"], contacts=1, grid=8, **more
    )
    monkeypatch.setenv("TOMOJAX_NATIVE", "1")
    monkeypatch.setenv("CC", "no-such-compiler")
    assert not make().native
    with pytest.raises(ValueError, match="compiler: got none, expected a C compiler"):
        make(native=True)


@pytest.mark.long
def test_the_same_code_serves_every_rig_of_its_shape(sensor, written, tmp_path):
    """With other tables: another pitch, drive, calibration, channels, highest voltage."""
    folder, name, _ = written
    other = tx.Sensor.grid(
        4, 4, pitch=0.022, drive_voltage=-3.0, dtype=np.float32, divisions=(20, 20)
    )
    rng, good = np.random.default_rng(0), np.ones(16, bool)
    good[5] = False
    rig = tx.Calibration(offset=rng.normal(0, 1e-3, 16), gain=rng.normal(1, 0.01, 16))
    step = tx.make_step(
        other, "follow", POLICIES, contacts=1, calibration=rig, good=good, highest=4.0
    )
    assert tx.step.compile(step, tmp_path / "other", libraries=False) == name
    one, two = ((f / "step.c").read_text() for f in (folder, tmp_path / "other"))
    assert one == two
    assert (
        ran(folder, tmp_path / "other" / "step.tables", tmp_path / "other").returncode == 0
    )


def ran(folder, tables, vectors, *flags):
    """Compiles check.c with a folder's library, and runs vectors with tables."""
    made = folder / "check"
    libraries = ["-l:libtomojax_step.a", "-lm"]
    command = [compiler(), folder / "check.c", f"-I{folder}", f"-L{folder}", *libraries]
    subprocess.run([*command, *flags, "-o", made], check=True)
    return subprocess.run(
        [made, tables, vectors / "vectors.bin"], capture_output=True, text=True, check=False
    )


@pytest.mark.long
def test_a_folder_for_programs_without_python(written):
    folder, name, step = written
    done = ran(folder, folder / "step.tables", folder)
    assert done.returncode == 0, done.stdout
    assert done.stdout.startswith("10000 slots: ")
    header = (folder / "tomojax_step.h").read_text()
    assert f'TOMOJAX_CODE "{name}"' in header and "TOMOJAX_ELECTRODES 16" in header
    undefined = subprocess.run(
        ["nm", "-u", folder / "libtomojax_step.a"],
        capture_output=True,
        text=True,
        check=True,
    )
    names = {line.split()[-1] for line in undefined.stdout.splitlines() if " U " in line}
    files = {"fclose", "fopen", "fread", "free", "malloc"}  # of tomojax_step_load alone
    maths = {"expf", "logf", "sinf", "powf", "fmodf", "floorf", "rintf", "atan2f", "cosf"}
    assert names <= files | maths | {"memcpy", "memset", "memcmp", "_GLOBAL_OFFSET_TABLE_"}


def test_the_example_reads_lines(written, levels):
    folder, _, step = written
    command = [compiler(), folder / "example.c", f"-I{folder}", f"-L{folder}"]
    libraries = ["-l:libtomojax_step.a", "-lm", "-o", folder / "example"]
    subprocess.run([*command, *libraries], check=True)
    state, ground, lines, expected = step.state, 0, [], []
    for _ in range(12):
        v = levels[1][ground].astype(np.float32)
        lines.append(f"{ground} 0 " + " ".join(repr(float(x)) for x in v))
        state, out = step(state, v, ground)
        ground = int(out.ground)
        expected.append((ground, int(out.flags), int(out.contacts.count)))
    lines.append("0 0 nan 1 2")  # a line that is cut
    done = subprocess.run(
        [folder / "example", folder / "step.tables"],
        input="\n".join(lines) + "\n", capture_output=True, text=True, check=True,
    )  # fmt: skip
    rows = [line.split() for line in done.stdout.splitlines()]
    assert [tuple(map(int, row[:3])) for row in rows[:-1]] == expected
    assert int(rows[-1][1]) & tx.Flag.BAD_VOLTAGES.value


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler is there")
def test_the_header_for_cpp(written, levels):
    folder, _, step = written
    program = folder / "loop.cpp"
    program.write_text(CPP)
    libraries = [f"-L{folder}", "-l:libtomojax_step.a", "-lm", "-o", folder / "loop"]
    command = ["g++", "-std=c++17", "-Wall", "-Werror", program, f"-I{folder}", *libraries]
    subprocess.run(command, check=True)
    volts = levels[1][0].astype(np.float32)
    done = subprocess.run(
        [folder / "loop", folder / "step.tables", *map(repr, map(float, volts))],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    out = step(step.state, volts, 0)[1]
    expected = int(out.contacts.count), int(out.flags), int(out.ground)
    assert tuple(map(int, done.stdout.split())) == expected
    wrong = [folder / "loop", folder / "step.c", *["0"] * 16]
    told = subprocess.run(wrong, capture_output=True, text=True, check=False)
    assert told.returncode == 2 and "another kind of file" in told.stderr


CPP = """
#include <cstdio>
#include <cstdlib>
#include "tomojax_step.hpp"
int main(int, char **arguments)
try {
    tomojax::Tables tables(arguments[1]);
    tomojax::Step step(tables);
    tomojax::Volts volts;
    for (std::size_t k = 0; k < volts.size(); k++)
        volts[k] = std::strtof(arguments[2 + k], nullptr);
    const auto &out = step(volts, 0);
    std::printf("%d %d %d\\n", out.count, out.flags, out.next_condition);
    step.use_policy(1);
    return step.image().size() == std::size_t(TOMOJAX_NX) * TOMOJAX_NY ? 0 : 1;
} catch (const std::exception &error) {
    std::fprintf(stderr, "%s\\n", error.what());
    return 2;
}
"""


def test_tables_that_are_not_its_own(written, tmp_path):
    folder, _, _ = written
    ran(folder, folder / "step.tables", folder)
    whole = (folder / "step.tables").read_bytes()
    changed = whole[:5000] + bytes([whole[5000] ^ 1]) + whole[5001:]
    other = whole[:20] + b"00000000" + whole[28:]
    for name, data, expected in (
        ("cut", whole[:-70], "cut or grew"),
        ("grown", whole + b"x", "cut or grew"),
        ("changed", changed, "bytes that have changed"),
        ("other", other, "those of another step's code"),
        ("none", b"PK\3\4" + whole, "another kind of file"),
        ("empty", b"", "another kind of file"),
    ):
        (tmp_path / name).write_bytes(data)
        command = [folder / "check", tmp_path / name, folder / "vectors.bin"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 2 and expected in done.stderr, (name, done.stderr)
        assert len(done.stderr.splitlines()) == 1
    command = [folder / "check", tmp_path / "missing", folder / "vectors.bin"]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 2


def test_a_folder_with_other_files(written, tmp_path):
    _, _, step = written
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ValueError, match="folder: got .*, expected a new folder"):
        tx.step.compile(step, tmp_path, libraries=False)
    assert (tmp_path / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["--method", "nothing"], "--method: got 'nothing'"),
        (["--policy", "nowhere"], "--policy: got 'nowhere'"),
        (["--contacts", "0"], "--contacts"),
        (["--march", "no-such"], "compiler: "),
        (["--like", "no-such.h5"], "no-such.h5"),
    ],
)
def test_wrong_arguments_of_the_command(given, expected, tmp_path, capsys, monkeypatch):
    words = ["tomojax", "compile-step", *given, "--out", "made"]
    if "--method" not in given:
        words += ["--method", "source"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    lines = capsys.readouterr().err.splitlines()
    assert ended.value.code == 2 and expected in lines[-1], lines
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("given, halved", [([], False), (["--half-tables"], True)])
def test_half_tables_are_asked_for(given, halved, tmp_path, monkeypatch, capsys):
    asked = {}

    def written(step, out, **more):
        asked.update(more)
        out.mkdir()
        (out / "step.tables").write_bytes(b"")
        return "code"

    monkeypatch.setattr(tx.step, "make_step", lambda *_, **__: None)
    monkeypatch.setattr(tx.step, "compile", written)
    words = ["tomojax", "compile-step", "--source", *given, "--out", str(tmp_path / "made")]
    monkeypatch.setattr(sys, "argv", words)
    with suppress(SystemExit):
        cli.main()
    assert asked["halved"] is halved and "step.tables" in capsys.readouterr().out


@pytest.mark.long
def test_hostile_slots_under_sanitizers(written, tmp_path):
    """Address and undefined behaviour; NaN, infinities and wrong grounds of every size."""
    folder, _, _ = written
    program = Path(__file__).parents[1] / "benchmarks" / "hostile.c"
    # Lines alone: to follow variables takes gcc half a minute.
    flags = ["-std=gnu99", "-O1", "-g1", "-fsanitize=address,undefined"]
    command = [compiler(), *flags, "-fno-sanitize-recover=all", f"-I{folder}"]
    made = tmp_path / "hostile"
    subprocess.run([*command, program, folder / "step.c", "-lm", "-o", made], check=True)
    done = subprocess.run(
        [made, folder / "step.tables", "100000"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[:2000]
    assert done.stdout == "100000 slots\n"


def test_a_step_needs_little_memory(written):
    """Of the stack, by the compiler's own count; and code without tables."""
    folder, _, _ = written
    command = [compiler(), "-std=gnu99", "-O1", "-fstack-usage", "-c", folder / "step.c"]
    subprocess.run([*command, "-o", folder / "usage.o"], check=True)
    told = (folder / "usage.su").read_text().splitlines()
    most = max(int(line.split("\t")[1]) for line in told)
    assert 0 < most < 128 * 1024
    loaded = ctypes.CDLL(str(folder / "libtomojax_step.so"))
    assert hasattr(loaded, "tomojax_step_image")
    assert (folder / "step.tables").stat().st_size < 1_600_000

"""`reconstruct`: what users call, with their mistakes, batches, weights and reduced J."""

import subprocess
import sys

import equinox as eqx
import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

import tomojax as tx
from tomojax.kernels.inverse import solve_reduced


@pytest.fixture(scope="module")
def problem():
    sensor = tx.Sensor.grid(divisions=(32, 32))
    j = tx.jacobian(sensor)
    scene = tx.Disc([0.0934, 0.0671], 0.006, 1.0)
    key = jax.random.key(0)
    volts = tx.voltages(tx.Sensor.grid(), scene, converter=tx.Converter(), key=key)
    return sensor, j, volts, tx.sensor.contact_conductance(sensor, scene)


def formula(j, v, lam, w=1.0):
    rows = np.asarray(j).reshape(-1, j.shape[-1])
    weights = np.broadcast_to(w, v.shape).ravel()[:, None]
    normal = rows.T @ (weights * rows) + lam * np.eye(j.shape[-1])
    return np.linalg.solve(normal, rows.T @ (weights[:, 0] * np.ravel(v)))


GROUNDS = np.array([0, 63, 18, 20, 36, 42])


def test_is_eq_3(problem) -> None:
    sensor, j, volts, truth = problem
    r = tx.reconstruct(j, volts[GROUNDS], GROUNDS, lam=50.0)
    exact = formula(j[GROUNDS], volts[GROUNDS], 50.0)
    np.testing.assert_allclose(r.image, exact, atol=1e-9 * np.abs(exact).max())
    rows = np.asarray(j[GROUNDS]).reshape(-1, 2048)
    rms = np.sqrt(np.mean((rows @ exact - np.ravel(volts[GROUNDS])) ** 2))
    np.testing.assert_allclose(r.residual, rms, rtol=1e-9)
    assert r.flags == 0 and r.lam == 50.0


@pytest.mark.long
def test_default_lambda_on_exact_voltages(problem) -> None:
    """Not J's own voltages: the image is then nearly as good as any λ makes it, and where
    no ground is under the contact its place is right to a third of a pitch."""
    sensor, j, volts, truth = problem
    around = tx.pattern(sensor, "around", volts[tx.paper.exploration(sensor)])
    for grounds in (GROUNDS, np.asarray(around)):
        r = tx.reconstruct(j, volts[grounds], grounds)
        figures = tx.paper.figures_of_merit(sensor, r.image, truth)
        reduced = tx.paper.reduce_jacobian(j, 512)
        frames = jnp.broadcast_to(volts[grounds], (11, *volts[grounds].shape))
        others = tx.reconstruct(reduced, frames, grounds, lam=10.0 ** np.arange(-5.0, 6.0))
        errors = tx.paper.figures_of_merit(sensor, others.image, truth).image_error
        assert figures.image_error <= 1.15 * errors.min()
    assert np.linalg.norm(figures.place - np.array([0.0934, 0.0671])) < 0.0067


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_reduced(problem, dtype) -> None:
    """256 of 2048 columns: the image to 1e-3 at a usual λ, in either dtype."""
    _, j, volts, _ = problem
    j, volts = j.astype(dtype), volts.astype(dtype)
    reduced = tx.paper.reduce_jacobian(j)
    full = tx.reconstruct(j, volts[GROUNDS], GROUNDS, lam=2000.0).image
    small = tx.reconstruct(reduced, volts[GROUNDS], GROUNDS, lam=2000.0)
    assert small.image.dtype == dtype
    assert jnp.linalg.norm(small.image - full) <= 1e-3 * jnp.linalg.norm(full)
    chosen = tx.reconstruct(reduced, volts)  # all 64 slots, λ by the default rule
    assert chosen.flags == 0 and chosen.lam > 0


def test_batch_and_one_lambda_for_it(problem) -> None:
    _, j, volts, _ = problem
    frames = jnp.stack([volts[GROUNDS], 0.5 * volts[GROUNDS], volts[GROUNDS][::-1]])
    each = tx.reconstruct(j, frames, GROUNDS, lam="gcv")
    one = tx.reconstruct(j, frames[1], GROUNDS, lam="gcv")
    np.testing.assert_allclose(each.image[1], one.image, rtol=1e-6, atol=1e-9)
    assert each.lam.shape == (3,) and len(set(each.lam.tolist())) > 1
    shared = tx.reconstruct(j, frames, GROUNDS, lam="gcv", per_recording=True)
    assert len(set(shared.lam.tolist())) == 1
    given = tx.reconstruct(j, frames, GROUNDS, lam=[10.0, 20.0, 30.0])
    np.testing.assert_allclose(
        given.image[2], tx.reconstruct(j, frames[2], GROUNDS, lam=30.0).image, rtol=1e-9
    )


@pytest.mark.long
@pytest.mark.parametrize("reduced", [False, True])
def test_weights_leave_out(problem, reduced) -> None:
    _, j, volts, _ = problem
    model = tx.paper.reduce_jacobian(j) if reduced else j
    v = volts[GROUNDS]
    fewer = tx.reconstruct(model, v[1:], GROUNDS[1:], lam=100.0)
    zero = tx.reconstruct(model, v, GROUNDS, lam=100.0, weights=[0, 1, 1, 1, 1, 1])
    np.testing.assert_allclose(zero.image, fewer.image, rtol=1e-6, atol=1e-9)
    # A missing channel: NaN where its weight is 0.
    w = np.ones(v.shape)
    w[:, 17] = 0
    missing = tx.reconstruct(model, v.at[:, 17].set(jnp.nan), GROUNDS, lam=100.0, weights=w)
    assert missing.flags == 0
    if not reduced:
        exact = formula(j[GROUNDS], v, 100.0, w)
        np.testing.assert_allclose(missing.image, exact, atol=1e-8 * np.abs(exact).max())


def test_one_trace_for_all_sets_and_lambdas(problem) -> None:
    """10 000 random sets and 20 values of λ are one trace; here a few of each."""
    _, j, volts, _ = problem
    reduced = tx.paper.reduce_jacobian(j, 64)

    @eqx.filter_jit
    @eqx.debug.assert_max_traces(max_traces=1)
    def image(grounds, lam):
        c = solve_reduced(reduced, grounds, volts[grounds], lam)
        return c @ reduced.basis

    rng = np.random.default_rng(0)
    for lam in (1.0, 30.0, 1000.0):
        for _ in range(3):
            grounds = jnp.asarray(rng.choice(64, 8, replace=False))
            assert jnp.isfinite(image(grounds, jnp.asarray(lam))).all()


def test_flags_inside_compiled_code(problem) -> None:
    _, j, volts, _ = problem
    flag = tx.Flag

    @jax.jit
    def run(v, grounds, lam):
        return tx.reconstruct(j, v, grounds, lam=lam)

    good, grounds = volts[GROUNDS], jnp.asarray(GROUNDS)
    assert run(good, grounds, 5.0).flags == 0
    for v, g, lam, wanted in [
        (good.at[2, 3].set(jnp.nan), grounds, 5.0, flag.BAD_VOLTAGES),
        (good.at[2, 3].set(jnp.inf), grounds, 5.0, flag.BAD_VOLTAGES),
        (good, grounds.at[0].set(63), 5.0, flag.BAD_GROUNDS),
        (good, grounds.at[0].set(64), 5.0, flag.BAD_GROUNDS),
        (good, grounds.at[0].set(-1), 5.0, flag.BAD_GROUNDS),
        (good, grounds, 0.0, flag.BAD_LAMBDA),
        (good, grounds, -1.0, flag.BAD_LAMBDA),
        (good, grounds, jnp.nan, flag.BAD_LAMBDA),
    ]:
        r = run(v, g, lam)
        assert int(r.flags) == wanted
        assert jnp.isnan(r.image).all()
    no_rule = jax.jit(lambda v: tx.reconstruct(j[:2], v, lam="cautious"))
    r = no_rule(good[:2].at[0, 0].set(jnp.nan))
    assert int(r.flags) & flag.BAD_VOLTAGES and jnp.isnan(r.image).all()


def test_noise_alone_is_said(problem) -> None:
    """A rule that runs to the largest λ that it tries has found nothing but noise."""
    _, j, volts, _ = problem
    reduced = tx.paper.reduce_jacobian(j, 64)
    noise = np.random.default_rng(3).normal(0, 3e-4, (4, 6, 64))
    frames = np.concatenate([noise, [volts[GROUNDS], 0.02 * volts[GROUNDS]]])
    r = tx.reconstruct(reduced, frames, GROUNDS)
    assert r.flags.tolist() == 4 * [tx.Flag.BAD_LAMBDA] + [0, 0]
    assert jnp.isfinite(r.image).all()
    shared = tx.reconstruct(reduced, frames, GROUNDS, per_recording=True)
    assert not np.asarray(shared.flags).any()
    # A λ that is given is nobody's search.
    assert tx.reconstruct(reduced, noise[0], GROUNDS, lam=float(r.lam[0])).flags == 0


def test_voltages_of_all_grounds_are_told_apart(problem) -> None:
    _, j, volts, _ = problem
    with pytest.raises(ValueError, match=r"voltages: got .*64, 64.*np.asarray\(grounds\)"):
        tx.reconstruct(j, volts, [0, 5], lam=1.0)


@pytest.mark.parametrize(
    "name, change",
    [
        ("voltages", dict(voltages=np.full((6, 64), np.nan))),
        ("voltages", dict(voltages=np.ones((5, 64)))),
        ("voltages", dict(voltages=np.ones((6, 63)))),
        ("voltages", dict(voltages="volts")),
        ("jacobian", dict(jacobian=np.ones((64, 64)))),
        ("jacobian", dict(jacobian="J")),
        ("grounds", dict(grounds=[])),
        ("grounds", dict(grounds=[0, 0, 1, 2, 3, 4])),
        ("grounds", dict(grounds=[0, 1, 2, 3, 4, 64])),
        ("grounds", dict(grounds=[-1, 1, 2, 3, 4, 5])),
        ("grounds", dict(grounds=[0.0, 1.0, 2.0, 3.0, 4.0, 5.0])),
        ("lam", dict(lam=0.0)),
        ("lam", dict(lam=-1.0)),
        ("lam", dict(lam=np.nan)),
        ("lam", dict(lam="best")),
        ("lam", dict(lam=[1.0, 2.0])),
        ("noise", dict(lam="discrepancy")),
        ("noise", dict(lam="discrepancy", noise=0.0)),
        ("weights", dict(weights=np.zeros(6))),
        ("weights", dict(weights=-np.ones(6))),
        ("weights", dict(weights=np.ones(5))),
        ("route", dict(route="svd")),
    ],
)
def test_bad_input(problem, name, change) -> None:
    _, j, volts, _ = problem
    arguments = dict(jacobian=j, voltages=volts[GROUNDS], grounds=GROUNDS, lam=1.0)
    with pytest.raises((ValueError, TypeCheckError), match=name):
        tx.reconstruct(**{**arguments, **change})


@pytest.mark.parametrize("rank", [0, 5000, 2.5, "all"])
def test_bad_rank(problem, rank) -> None:
    with pytest.raises((ValueError, TypeCheckError), match="rank"):
        tx.paper.reduce_jacobian(problem[1], rank)


def test_figures_of_merit_check_shapes(problem) -> None:
    sensor, _, _, truth = problem
    images = jnp.stack([truth, 2 * truth])
    many = tx.paper.figures_of_merit(sensor, images, truth)
    assert many.half_width.shape == (2,) and many.place.shape == (2, 2)
    np.testing.assert_allclose(many.image_error, 0, atol=1e-7)
    for image, true, name in [
        (truth[:-1], truth, "image"),
        (truth, truth[:-1], "image|truth"),
        (truth * jnp.nan, truth, "image"),
        (images, images[:1], "truth"),
    ]:
        with pytest.raises(ValueError, match=name):
            tx.paper.figures_of_merit(sensor, image, true)


LOADED = """
import sys, numpy as np, tomojax as tx
kept, data = open(sys.argv[1], "rb").read(), np.load(sys.argv[2])
found = tx.paper.load_exported(kept).call(data["v"])
print(float(np.abs(np.asarray(found) - data["image"]).max() / np.abs(data["image"]).max()))
"""


def test_another_process_calls_an_exported_function(tmp_path) -> None:
    sensor = tx.Sensor.grid(4, 4, divisions=(16, 16), dtype=np.float32)
    rows = tx.jacobian(sensor, [0, 15])
    lam = 1e-3 * float((np.asarray(rows) ** 2).sum())
    image = jax.jit(lambda v: tx.reconstruct(rows, v, lam=lam).image)
    disc = tx.Disc([0.03, 0.05], 0.006, 1.0)
    volts = np.asarray(tx.voltages(sensor, disc, [0, 15]), np.float32)
    kept, data = tmp_path / "kept.bin", tmp_path / "data.npz"
    kept.write_bytes(bytes(jax.export.export(image)(volts).serialize()))
    np.savez(data, v=volts, image=np.asarray(image(volts)))
    run = [sys.executable, "-W", "ignore", "-c", LOADED, str(kept), str(data)]
    told = subprocess.run(run, capture_output=True, text=True, timeout=120)
    assert told.returncode == 0 and float(told.stdout) < 1e-4

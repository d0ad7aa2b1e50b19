"""Each operation as C beside the same as a program of JAX."""

import ctypes

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from tomojax.native import (
    compile_c,
    compiler,
    FLAGS,
    function,
    PRELUDE,
    program_of,
    Tables,
)

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler is there")

RNG = np.random.default_rng(0)
TABLE = RNG.normal(size=(9, 7, 5))
CHOICE = RNG.random((4, 4)) > 0.5


def floats(*shape):
    return RNG.normal(size=shape)


def whole(*shape, most=9):
    return RNG.integers(-most, most, shape)


ODD = np.array([np.nan, np.inf, -np.inf, -0.0, 0.0, 1.5, -2.5, 3e9])

# Name: a function of arrays, and the arrays. Floats take the type that is tested.
CASES = {
    "arithmetic": (lambda a, b: (a + b, a - b, a * b, a / b, -a, abs(a)), ODD, ODD[::-1]),
    "order": (lambda a, b: (jnp.maximum(a, b), jnp.minimum(a, b), a < b, a >= b, a == b),
              ODD, ODD[::-1].copy()),
    "sign": (lambda a: (jnp.sign(a), jnp.isfinite(a), jnp.floor(a), jnp.ceil(a)), ODD),
    "round": (lambda a: (jnp.round(a), lax.round(a)), np.array([0.5, 1.5, -0.5, 2.4])),
    "functions": (lambda a: (jnp.exp(a), jnp.sin(a), jnp.cos(a), jnp.tanh(a),
                             jnp.log(a * a), jnp.sqrt(a * a), lax.rsqrt(a * a + 1),
                             jnp.log1p(a * a), jnp.expm1(a)), floats(5)),
    "two numbers": (lambda a, b: (jnp.arctan2(a, b), jnp.abs(a) ** b, a % b), floats(6),
                    floats(6)),
    "powers": (lambda a: (a**2, a**3, a**-1, a**-2, a**7, a**0), floats(4)),
    "whole numbers": (lambda a, b: (a + b, a * b, a - b, a // b, a % b, -a, abs(a), a & b,
                                    a | b, a ^ b, ~a, lax.div(a, b), lax.rem(a, b)),
                      np.array([7, -7, 5, 2**31 - 1]), np.array([2, 2, 0, 3])),
    "truths": (lambda a, b: (a & b, a | b, ~a, a ^ b, a.all(), b.any(), jnp.sum(a)),
               RNG.random(9) > 0.5, RNG.random(9) > 0.5),
    "types": (lambda a: (a.astype(jnp.int32), a.astype(jnp.uint8), (a > 0).astype(a.dtype),
                         a.astype(bool)), ODD),
    "bits": (lambda a: lax.bitcast_convert_type(
        lax.bitcast_convert_type(a, jnp.int32 if a.dtype == jnp.float32 else jnp.int64) ^ 1,
        a.dtype), floats(4)),
    "choice": (lambda a: jnp.where(CHOICE, a[:, None] - a, 1) / jnp.where(CHOICE, a, 2),
               floats(4)),
    "choice of three": (lambda a, k: lax.select_n(k, a, 2 * a, 3 * a), floats(6),
                        np.array([0, 1, 2, 2, 1, 0], np.int32)),
    "clamp": (lambda a: (jnp.clip(a, -1, 1), lax.clamp(a.min() / 2, a, a.max() / 2)),
              floats(5)),
    "layout": (lambda a: (a.T, a.reshape(-1), a[:, ::2], a[1:, None], a[::-1],
                          jnp.broadcast_to(a, (2, *a.shape)),
                          lax.reshape(a, (5, 4), (1, 0))),
               floats(4, 5)),
    "joined": (lambda a, b: (jnp.concatenate([a, b, a], 1), jnp.stack([a[:, 0], b[:, 1]]),
                             jnp.pad(a, ((1, 2), (0, 1))), *jnp.split(b, 2)),
               floats(4, 3), floats(4, 2)),
    "at a place": (lambda a, i: (a[i], a[:, i], lax.dynamic_slice(a, (i, i), (2, 3)),
                                 lax.dynamic_update_slice(a, a[:2, :2] * 2, (i, i))),
                   floats(5, 6), np.int32(3)),
    "outside": (lambda a, i: (lax.dynamic_slice(a, (i,), (3,)), a.at[i].get(mode="fill"),
                              a.at[i].get(mode="clip"), a.at[i].set(7, mode="drop")),
                floats(6), np.int32(40)),
    "gathered": (lambda a, i: (a[i], a[i, 1], jnp.take(a, i, 1),
                               jnp.take_along_axis(a[:3], i[:, None], 1)),
                 floats(6, 5), np.array([0, 4, 2], np.int32)),
    "a table": (lambda i, w: (jnp.asarray(TABLE, w.dtype)[i] * w[:, None]).sum(1),
                np.array([1, 8, 3], np.int32), floats(7)),
    "scattered": (lambda a, i: (a.at[i].set(1.0), a.at[i].add(a[:3]), a.at[i, 0].set(2.0),
                                a.at[:, 1].add(a[:, 0])), floats(6, 4),
                  np.array([5, 0, 2], np.int32)),
    "sums": (lambda a: (a.sum(), a.sum(0), a.sum(1), a.sum((0, 2)), a.mean(-1), a.prod(1),
                        a.max(0), a.min((1, 2)), a.max()), floats(3, 4, 5)),
    "with NaN": (lambda a: (a.max(), a.min(), jnp.argmax(a), jnp.argmin(a)), ODD),
    "where": (lambda a: (jnp.argmax(a), jnp.argmax(a, 1), jnp.argmin(a, 0),
                         jnp.argmax(a > 0, 1)), floats(4, 6)),
    "running": (lambda a: (jnp.cumsum(a, 0), jnp.cumsum(a, 1), lax.cummax(a, 0),
                           lax.cumsum(a, 0, reverse=True)), floats(4, 3)),
    "products": (lambda a, b, c: (a @ b, b.T @ a.T, a @ c, c @ b, c @ c, a[0] @ a.T,
                                  jnp.einsum("ij,kj->ik", a, a),
                                  jnp.einsum("bij,bj->bi", jnp.stack([a, a]),
                                             jnp.stack([c, c + 1]))),
                 floats(7, 9), floats(9, 8), floats(9)),
    # Joined where one matrix has several vectors, in blocks of columns and beyond.
    "joined products": (lambda a, b: (*(x @ b for x in a), a[0] @ b[:, :16],
                                      (a[1] @ b) @ b.T, (a[2] * (a[0] @ b).sum()) @ b),
                        floats(9, 7), floats(7, 37)),
    "largest": (lambda a, b: (a.max(), jnp.argmax(a), (a + b).max(), jnp.argmax(a + b),
                              jnp.argmax(-b), (b > 9).any()),
                floats(50), np.where(np.arange(50) == 31, np.nan, np.inf)),
    "sorted": (lambda a: (jnp.sort(a), jnp.argsort(a)), ODD),
    "solved": (lambda a, b: (jnp.linalg.solve(a, b), jnp.linalg.solve(a, b[:, None])),
               floats(6, 6), floats(6)),
    "branches": (lambda a, k: lax.switch(k, [lambda: a, lambda: 2 * a, lambda: a[::-1]]),
                 floats(4), np.int32(2)),
    "a branch outside": (lambda a, k: lax.switch(k, [lambda: a, lambda: 2 * a]), floats(4),
                         np.int32(-5)),
    "a loop": (lambda a: lax.fori_loop(0, 6, lambda i, s: (s[1], s[0] + s[1] * i), (a, -a)),
               floats(3)),
    "rows": (lambda a: lax.scan(lambda s, x: (s + x.sum(), x * s), 0 * a[0, 0], a),
             floats(5, 3)),
    "rows with work between": (lambda a: lax.map(
        lambda x: ((a * x) @ a.T, jnp.sort(a @ x), (a + x).sum(0)), a), floats(5, 5)),
    "rows backwards": (lambda a: lax.scan(lambda s, x: (s * x, s), jnp.ones((), a.dtype), a,
                                          reverse=True), floats(5)),
    "until": (lambda a: lax.while_loop(lambda s: s[0].sum() < 50,
                                       lambda s: (s[0] * 2, s[1] + 1), (jnp.abs(a), 0)),
              floats(3)),
    "slopes": (lambda a: jax.jacfwd(lambda x: jnp.prod(
        jnp.where(CHOICE, 1, x[None] - x[:, None] * x**2), 1))(a), floats(4)),
}  # fmt: skip


def cast(arrays, dtype):
    """Floats of the type that is tested; whole numbers of 32 bits."""
    kinds = {"f": dtype, "i": np.int32, "b": bool, "u": np.uint8}
    return [np.asarray(a, kinds[np.asarray(a).dtype.kind]) for a in arrays]


@pytest.fixture(scope="module", params=[np.float32, np.float64], ids=["float32", "float64"])
def library(request, tmp_path_factory):
    """All cases in one library, as a step's functions are: a compiler begins once."""
    dtype, tables = request.param, Tables()
    texts, made = [PRELUDE], {}
    for k, (name, (f, *arrays)) in enumerate(CASES.items()):
        given = cast(arrays, dtype)
        flat = lambda *a, f=f: tuple(jax.tree.leaves(f(*a)))  # noqa: E731
        body = program_of(flat, *given)
        texts.append(function(f"run{k}", body, tables))
        count = len(body.inputs) + len(body.outputs)
        passed = ", ".join(f"p[{i}]" for i in range(count))
        texts.append(f"void go{k}(const char *T, void **p) {{ run{k}(T, {passed}); }}\n")
        made[name] = k, flat, given, body.outputs
    folder = tmp_path_factory.mktemp("native")
    (folder / "all.c").write_text("\n".join(texts))
    compile_c(folder / "all.c", folder / "all.so", "-march=native")
    room = np.zeros(tables.size + 64, np.uint8)
    data = room[-room.ctypes.data % 64 :][: tables.size]
    data[:] = np.frombuffer(tables.packed(), np.uint8)
    return ctypes.CDLL(str(folder / "all.so")), data, made


@pytest.mark.parametrize("name", CASES)
def test_an_operation(library, name):
    loaded, data, made = library
    k, f, given, outputs = made[name]
    # Truths are as wide as numbers in C.
    kept = [np.int32 if v.dtype == bool else v.dtype for v in outputs]
    found = [np.zeros(v.shape, kind) for v, kind in zip(outputs, kept, strict=True)]
    given_c = [
        a.astype(np.int32) if a.dtype == bool else np.ascontiguousarray(a) for a in given
    ]
    arrays = [*given_c, *found]
    pointers = (ctypes.c_void_p * len(arrays))(*(a.ctypes.data for a in arrays))
    loaded[f"go{k}"](ctypes.c_void_p(data.ctypes.data), pointers)
    expected = jax.jit(f)(*given)
    floats_ = next((a.dtype for a in given if a.dtype.kind == "f"), np.dtype(np.float64))
    rtol = 2e-5 if floats_ == np.float32 else 1e-12
    assert len(found) == len(expected)
    for mine, theirs in zip(found, expected, strict=True):
        theirs = np.asarray(theirs)
        assert mine.shape == theirs.shape
        np.testing.assert_allclose(mine, theirs, rtol=rtol, atol=rtol)


def test_an_operation_without_c():
    body = program_of(lambda a: (lax.erf_inv(a),), np.zeros(4))
    with pytest.raises(ValueError, match="operation: got erf_inv, expected one of"):
        function("run", body, Tables())


def test_code_does_not_depend_on_a_tables_values():
    """Nor on whether two of them are equal."""

    def text(a, b):
        tables = Tables()
        a, b = jnp.asarray(a), jnp.asarray(b)
        return function("run", program_of(lambda x: (x * a + b,), np.zeros(3)), tables)

    assert text(np.ones(3), np.ones(3)) == text(np.arange(3.0), np.full(3, 7.0))


def test_a_compiler_that_is_missing_or_fails(tmp_path, monkeypatch):
    source = tmp_path / "wrong.c"
    source.write_text("int f( {")
    with pytest.raises(ValueError, match="compiler: .* failed: .*error"):
        compile_c(source, tmp_path / "wrong.so")
    monkeypatch.setenv("CC", "no-such-compiler")
    assert compiler() is None
    with pytest.raises(ValueError, match="compiler: got none, expected a C compiler"):
        compile_c(source, tmp_path / "wrong.so")
    assert "-ffast-math" not in FLAGS  # NaN tells of channels that gave nothing

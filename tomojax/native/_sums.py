"""Writes operations along axes: sums, products of matrices, orders and small solvers."""

import numpy as np

from tomojax.native._places import c_type, Index, linear, literal, View
from tomojax.native._program import Op, Value
from tomojax.native._writer import Writer

# Fewer elements than this are not worth a loop of their own for each lane.
_LANES = 4

# The largest of so many is found by lanes of them.
_LONG = 32

_OF_REDUCTION = {
    "reduce_sum": ("+", 0),
    "reduce_prod": ("*", 1),
    "reduce_max": ("max", -np.inf),
    "reduce_min": ("min", np.inf),
    "reduce_or": ("|", 0),
    "reduce_and": ("&", 1),
}


def reduction(w: Writer, op: Op) -> None:
    (of,), (out,) = op.inputs, op.outputs
    axes = {int(a) % len(of.shape) for a in op.params["axes"]}
    kept = [a for a in range(len(of.shape)) if a not in axes]
    sign, first = _OF_REDUCTION[op.name]
    place = w.place(of)
    dtype = out.dtype
    if dtype.kind in "iu" and sign in ("max", "min"):
        first = np.iinfo(dtype).min if sign == "max" else np.iinfo(dtype).max
    begun = literal(first, dtype)

    def joined(a: str, b: str) -> str:
        if sign in ("max", "min"):
            return f"tj_{sign}_{c_type(dtype)}({a}, {b})"
        return f"{a} {sign} {b}"

    if sign == "max" and not kept and dtype.kind == "f" and of.size >= _LONG:
        view = w.contiguous(of)
        call = f"tj_largest_{c_type(dtype)}({of.size}, &{view.buffer}[{view.offset}])"
        w.set(out, lambda _: call)
        return
    long = [of.shape[a] for a in sorted(axes)]
    lanes = bool(kept) and kept[-1] == len(of.shape) - 1 and of.shape[-1] >= _LANES
    target = w.target(out)
    if lanes:
        # Whole rows are joined: one element of each lane after the other.
        with w.loops(out.shape) as index:
            w.line(f"{target.at(index)} = {begun};")
        with w.loops(out.shape[:-1]) as outer, w.loops(long) as inner:
            with w.loops(out.shape[-1:], "") as last:
                index = [*outer, *last]
                at = _merged(of, kept, axes, index, inner)
                w.line(f"{target.at(index)} = {joined(target.at(index), place.at(at))};")
    else:
        with w.loops(out.shape) as index:
            sum_ = w.name("s")
            w.line(f"{c_type(dtype)} {sum_} = {begun};")
            simd = f"reduction({sign}:{sum_})" if dtype.kind == "f" and sign in "+*" else ""
            with w.loops(long, simd) as inner:
                at = _merged(of, kept, axes, index, inner)
                w.line(f"{sum_} = {joined(sum_, place.at(at))};")
            w.line(f"{target.at(index)} = {sum_};")
    w.places[id(out)] = target


def _merged(
    of: Value, kept: list[int], axes: set[int], index: Index, inner: Index
) -> list[str | int]:
    whole: list[str | int] = [0] * len(of.shape)
    for axis, at in zip(kept, index, strict=True):
        whole[axis] = at
    for axis, at in zip(sorted(axes), inner, strict=True):
        whole[axis] = at
    return whole


def argument(w: Writer, op: Op) -> None:
    """Writes where the largest or the smallest is: the first of them, or the first NaN."""
    (of,), (out,) = op.inputs, op.outputs
    (axis,) = (int(a) for a in op.params["axes"])
    kept = [a for a in range(len(of.shape)) if a != axis]
    sign = ">" if op.name == "argmax" else "<"
    kind = c_type(of.dtype)
    if op.name == "argmax" and not kept and of.dtype.kind == "f" and of.size >= _LONG:
        view = w.contiguous(of)
        call = f"tj_largest_at_{kind}({of.size}, &{view.buffer}[{view.offset}])"
        w.set(out, lambda _: call)
        return
    place, target = w.place(of), w.target(out)
    with w.loops(out.shape) as index:
        best, which = w.name("s"), w.name("s")
        first = place.at(_merged(of, kept, {axis}, index, [0]))
        w.line(f"{kind} {best} = {first}; int32_t {which} = 0;")
        at = w.name("i")
        with w.block(f"for (int {at} = 1; {at} < {of.shape[axis]}; {at}++)"):
            new = w.name("s")
            text = place.at(_merged(of, kept, {axis}, index, [at]))
            w.line(f"const {kind} {new} = {text};")
            better = f"{new} {sign} {best}"
            if of.dtype.kind == "f":
                better = f"({better} || {new} != {new}) && {best} == {best}"
            w.line(f"if ({better}) {{ {best} = {new}; {which} = {at}; }}")
        w.line(f"{target.at(index)} = {which};")
    w.places[id(out)] = target


def dot_general(w: Writer, op: Op) -> None:
    """Writes Σ_k a(b, i, k) · c(b, k, j), along the axis that lies in a row."""
    (a, c), (out,) = op.inputs, op.outputs
    (over_a, over_c), (batch_a, batch_c) = op.params["dimension_numbers"]
    free_a = [n for n in range(len(a.shape)) if n not in (*over_a, *batch_a)]
    free_c = [n for n in range(len(c.shape)) if n not in (*over_c, *batch_c)]
    left, right = w.stored(a), w.stored(c)
    long = [a.shape[n] for n in over_a]
    batch = [a.shape[n] for n in batch_a]
    rows, columns = [a.shape[n] for n in free_a], [c.shape[n] for n in free_c]
    target = w.target(out)

    def part(view: View, axes: tuple, index: tuple) -> str:
        whole: list[str | int] = [0] * len(view.shape)
        for some, at in zip(axes, index, strict=True):
            for axis, i in zip(some, at, strict=True):
                whole[axis] = i
        return view.at(whole)

    def product(b: Index, i: Index, j: Index, k: Index) -> str:
        x = part(left, (batch_a, free_a, over_a), (b, i, k))
        y = part(right, (batch_c, free_c, over_c), (b, j, k))
        return f"{x} * {y}"

    along_c = bool(columns) and columns[-1] >= _LANES and right.strides[free_c[-1]] == 1
    along_a = bool(rows) and rows[-1] >= _LANES and left.strides[free_a[-1]] == 1
    if along_c or (along_a and not columns):
        zero = literal(0, out.dtype)
        with w.loops(out.shape) as index:
            w.line(f"{target.at(index)} = {zero};")
        outer, last = (rows, columns) if along_c else ([], rows)
        with w.loops([*batch, *outer]) as some, w.loops(long) as k, w.loops(last) as lane:
            b, i = some[: len(batch)], some[len(batch) :]
            i, j = (i, lane) if along_c else (lane, [])
            w.line(f"{target.at([*b, *i, *j])} += {product(b, i, j, k)};")
    else:
        with w.loops([*batch, *rows, *columns]) as index:
            b, i = index[: len(batch)], index[len(batch) : len(batch) + len(rows)]
            j = index[len(batch) + len(rows) :]
            sum_ = w.name("s")
            w.line(f"{c_type(out.dtype)} {sum_} = 0;")
            with w.loops(long, f"reduction(+:{sum_})") as k:
                w.line(f"{sum_} += {product(b, i, j, k)};")
            w.line(f"{target.at(index)} = {sum_};")
    w.places[id(out)] = target


def dots(w: Writer, op: Op) -> None:
    """Writes products of vectors with one matrix."""
    matrix, *vectors = op.inputs
    view, count, (n, wide) = w.contiguous(matrix), len(vectors), matrix.shape
    rows = w.buffer(matrix.dtype, n * count)
    places = [w.place(v) for v in vectors]
    with w.loops([n]) as k:
        for v, place in enumerate(places):
            w.line(f"{rows}[{linear(str(v), k, [count])}] = {place.at(k)};")
    out = w.buffer(matrix.dtype, count * wide)
    call = f"tj_dots{count}_{c_type(matrix.dtype)}"
    w.line(f"{call}({n}, {wide}, &{view.buffer}[{view.offset}], {rows}, {out});")
    for v, value in enumerate(op.outputs):
        w.places[id(value)] = View(out, v * wide, (1,), (wide,))


def sort(w: Writer, op: Op) -> None:
    """Writes a stable sort by insertion of short rows by their first key; NaN come last."""
    ranks = {len(v.shape) for v in op.inputs}
    if ranks != {1} or op.params["num_keys"] != 1:
        raise ValueError("sort: got several axes or keys, expected one of each")
    n = op.inputs[0].shape[0]
    targets = [w.store(v, w.place(v)) for v in op.inputs]
    key, dtype = targets[0], op.inputs[0].dtype
    i, j = w.name("i"), w.name("i")
    with w.block(f"for (int {i} = 1; {i} < {n}; {i}++)"):
        held = [w.name("s") for _ in targets]
        for name, target, value in zip(held, targets, op.inputs, strict=True):
            w.line(f"const {c_type(value.dtype)} {name} = {target.at([i])};")
        before = key.at([f"{j} - 1"])
        after = f"{before} > {held[0]}"
        if dtype.kind == "f":
            after = f"({after} || ({before} != {before} && {held[0]} == {held[0]}))"
        w.line(f"int {j} = {i};")
        with w.block(f"for (; {j} > 0 && {after}; {j}--)"):
            for target in targets:
                w.line(f"{target.at([j])} = {target.at([f'{j} - 1'])};")
        for name, target in zip(held, targets, strict=True):
            w.line(f"{target.at([j])} = {name};")
    for value, target in zip(op.outputs, targets, strict=True):
        w.places[id(value)] = target


def lu(w: Writer, op: Op) -> None:
    """Writes P·A = L·U with the largest pivot of each column."""
    (of,), (out, pivots, order) = op.inputs, op.outputs
    n = _square(of)
    target, at, order_at = w.store(out, w.place(of)), w.target(pivots), w.target(order)
    kind = c_type(out.dtype)
    w.line(f"tj_lu_{kind}({n}, {target.buffer}, {at.buffer}, {order_at.buffer});")
    for value, place in zip(op.outputs, (target, at, order_at), strict=True):
        w.places[id(value)] = place


def triangular_solve(w: Writer, op: Op) -> None:
    a, b = op.inputs
    (out,), params, n = op.outputs, op.params, _square(a)
    if not params["left_side"] or len(b.shape) != 2 or params["conjugate_a"]:
        raise ValueError("triangular_solve: got another, expected A⁻¹B of one matrix")
    view, target = w.contiguous(a), w.store(out, w.place(b))
    lower = params["lower"] != params["transpose_a"]
    kind, turned, unit = c_type(out.dtype), params["transpose_a"], params["unit_diagonal"]
    flags = ", ".join(str(int(bool(f))) for f in (lower, turned, unit))
    matrix = f"&{view.buffer}[{view.offset}]"
    w.line(f"tj_triangular_{kind}({n}, {b.shape[1]}, {matrix}, {target.buffer}, {flags});")
    w.places[id(out)] = target


def cumulative(w: Writer, op: Op) -> None:
    (of,), (out,), axis = op.inputs, op.outputs, op.params["axis"]
    sign = {"cumsum": "+", "cumprod": "*", "cummax": "max", "cummin": "min"}[op.name]
    place, target = w.place(of), w.target(out)
    rest = [n for a, n in enumerate(of.shape) if a != axis]
    n = of.shape[axis]
    with w.loops(rest) as index:
        i, sum_ = w.name("i"), w.name("s")
        back = bool(op.params["reverse"])

        def at(where: str) -> list[str | int]:
            return [*index[:axis], where, *index[axis:]]

        kind = c_type(out.dtype)
        first = at(str(n - 1) if back else "0")
        w.line(f"{kind} {sum_} = {place.at(first)};")
        w.line(f"{target.at(first)} = {sum_};")
        with w.block(f"for (int {i} = 1; {i} < {n}; {i}++)"):
            where = at(f"({n - 1} - {i})" if back else i)
            new = place.at(where)
            text = (
                f"{sum_} {sign} {new}"
                if sign in "+*"
                else f"tj_{sign}_{kind}({sum_}, {new})"
            )
            w.line(f"{sum_} = {text};")
            w.line(f"{target.at(where)} = {sum_};")
    w.places[id(out)] = target


def _square(value: Value) -> int:
    if len(value.shape) != 2 or value.shape[0] != value.shape[1]:
        raise ValueError(f"matrix: got shape {value.shape}, expected one square matrix")
    return value.shape[0]


SUMS = {
    **dict.fromkeys(_OF_REDUCTION, reduction),
    "argmax": argument,
    "argmin": argument,
    "dot_general": dot_general,
    "dots": dots,
    "sort": sort,
    "lu": lu,
    "triangular_solve": triangular_solve,
    **dict.fromkeys(("cumsum", "cumprod", "cummax", "cummin"), cumulative),
}

"""Writes operations on windows at indices: gathers them, and scatters into them."""

from typing import Any

import numpy as np

from tomojax.native._places import Index, linear, literal, row_major, View
from tomojax.native._program import Op, Value
from tomojax.native._writer import Writer


def gather(w: Writer, op: Op) -> None:
    """Writes windows at indices; an index outside is moved in, or its window filled."""
    (of, indices), (out,) = op.inputs, op.outputs
    numbers, sizes = op.params["dimension_numbers"], op.params["slice_sizes"]
    fills = "FILL" in str(op.params["mode"])
    window_axes = list(map(int, numbers.offset_dims))
    batch_axes = [a for a in range(len(out.shape)) if a not in window_axes]
    gone = {
        *map(int, numbers.collapsed_slice_dims),
        *map(int, numbers.operand_batching_dims),
    }
    kept = [a for a in range(len(of.shape)) if a not in gone]
    batch = [out.shape[a] for a in batch_axes]
    # The last axis must be whole: its columns have a lowest value and a step each.
    columns = kept[-1:] == [len(of.shape) - 1] and sizes[-1] == of.shape[-1]
    half = w.half(of) if columns else None
    view = w.stored(of) if half is None else half[0]
    start, good = _starts(w, view, of, indices, numbers, sizes, batch, fills)
    strides = [0] * len(out.shape)
    for to, axis in zip(window_axes, kept, strict=True):
        strides[to] = view.strides[axis]
    if int(np.prod(batch)) == 1 and not fills and half is None:
        offset = f"{start.at([0] * len(batch))} + {view.offset}"
        w.places[id(out)] = View(view.buffer, offset, tuple(strides), out.shape)
        return
    missing = literal(_fill(op, of.dtype), of.dtype)

    def read(index: Index) -> str:
        at = [index[a] for a in batch_axes]
        where = linear(f"{start.at(at)} + {view.offset}", index, strides)
        text = f"{view.buffer}[{where}]"
        if half is not None:
            column = index[window_axes[-1]]
            text = f"({half[1]}[{column}] + {half[2]}[{column}] * {text})"
        return text if good is None else f"({good.at(at)} ? {text} : {missing})"

    w.set(out, read)


def _fill(op: Op, dtype: np.dtype) -> Any:
    """Returns what a window outside is filled with: JAX's own choice where none is told."""
    told = op.params["fill_value"]
    if told is not None:
        return told
    if dtype.kind == "f":
        return np.nan
    least = {"i": lambda: np.iinfo(dtype).min, "u": lambda: np.iinfo(dtype).max}
    return least.get(dtype.kind, lambda: 1)()


def _starts(
    w: Writer,
    view: View,
    of: Value,
    indices: Value,
    numbers: Any,
    sizes: Any,
    batch: list[int],
    fills: bool,
) -> tuple[View, View | None]:
    """Writes where the windows of a batch begin, and whether each is inside."""
    shape = tuple(batch)
    size = int(np.prod(batch))
    full = row_major(shape)
    start = View(w.buffer(np.dtype(np.int32), size), 0, full, shape)
    good = View(w.buffer(np.dtype(bool), size), 0, full, shape) if fills else None
    batching = zip(
        numbers.operand_batching_dims,
        getattr(numbers, "start_indices_batching_dims", None)
        or getattr(numbers, "scatter_indices_batching_dims", ()),
        strict=True,
    )
    indexed = getattr(numbers, "start_index_map", None)
    if indexed is None:
        indexed = numbers.scatter_dims_to_operand_dims
    place = w.place(indices)
    with w.loops(shape) as at:
        parts, tests = [], []
        for k, axis in enumerate(map(int, indexed)):
            most = of.shape[axis] - int(sizes[axis])
            value = place.at([*at, k])
            if fills:
                tests.append(f"{value} >= 0 && {value} <= {most}")
            if most:
                parts.append(f"tj_within({value}, {most})*{view.strides[axis]}")
        for axis, of_index in batching:
            parts.append(f"{at[int(of_index)]}*{view.strides[int(axis)]}")
        w.line(f"{start.at(at)} = {' + '.join(parts) or '0'};")
        if good is not None:
            w.line(f"{good.at(at)} = {' && '.join(tests) or '1'};")
    return start, good


def scatter(w: Writer, op: Op) -> None:
    """Writes windows into a copy; a window that is not all inside is left out."""
    (of, indices, updates), (out,) = op.inputs, op.outputs
    numbers = op.params["dimension_numbers"]
    adds = op.name != "scatter"
    if op.name not in ("scatter", "scatter-add", "scatter_add"):
        raise ValueError(f"operation: got {op.name}, expected scatter or scatter-add")
    window_axes = list(map(int, numbers.update_window_dims))
    gone = {
        *map(int, numbers.inserted_window_dims),
        *map(int, numbers.operand_batching_dims),
    }
    kept = [a for a in range(len(of.shape)) if a not in gone]
    sizes = [1] * len(of.shape)
    for axis, of_update in zip(kept, window_axes, strict=True):
        sizes[axis] = updates.shape[of_update]
    batch_axes = [a for a in range(len(updates.shape)) if a not in window_axes]
    batch = [updates.shape[a] for a in batch_axes]
    target = w.store(out, w.place(of))
    fills = "CLIP" not in str(op.params["mode"])
    start, good = _starts(w, target, of, indices, numbers, sizes, batch, fills)
    strides = [0] * len(updates.shape)
    for of_update, axis in zip(window_axes, kept, strict=True):
        strides[of_update] = target.strides[axis]
    place = w.place(updates)
    with w.loops(updates.shape) as index:
        at = [index[a] for a in batch_axes]
        where = linear(start.at(at), index, strides)
        asked = "" if good is None else f"if ({good.at(at)}) "
        sign = "+=" if adds else "="
        w.line(f"{asked}{target.buffer}[{where}] {sign} {place.at(index)};")
    w.places[id(out)] = target

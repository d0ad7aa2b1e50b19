"""Writes operations that only say where elements are, or put them together."""

from typing import Any

from tomojax.native._places import Index, Lazy, linear, row_major, View
from tomojax.native._program import Op, Value
from tomojax.native._windows import gather, scatter
from tomojax.native._writer import Writer


def _moved(w: Writer, op: Op, view: Any, index_of: Any) -> None:
    """Gives a value by another's elements: as a view of memory, or where it is read."""
    (of, *_), (out,) = op.inputs, op.outputs
    place = w.place(of)
    if isinstance(place, View):
        w.places[id(out)] = view(place)
    elif out.size == 1 or of.size == 1:
        w.places[id(out)] = Lazy(out.shape, lambda index: place.at(index_of(index)))
    else:
        w.set(out, lambda index: place.at(index_of(index)))


def broadcast(w: Writer, op: Op) -> None:
    (of, *_), (out,) = op.inputs, op.outputs
    at = op.params["broadcast_dimensions"]

    def view(place: View) -> View:
        strides = [0] * len(out.shape)
        for axis, (to, n) in enumerate(zip(at, of.shape, strict=True)):
            strides[to] = 0 if n == 1 else place.strides[axis]
        return View(place.buffer, place.offset, tuple(strides), out.shape)

    def index_of(index: Index) -> Index:
        return [0 if n == 1 else index[to] for to, n in zip(at, of.shape, strict=True)]

    if isinstance(w.place(of), Lazy) and 1 < of.size < out.size:
        w.stored(of)
    _moved(w, op, view, index_of)


def squeeze(w: Writer, op: Op) -> None:
    of = op.inputs[0]
    gone = {d % len(of.shape) for d in op.params["dimensions"]}
    left = [axis for axis in range(len(of.shape)) if axis not in gone]

    def index_of(index: Index) -> Index:
        whole: list[Any] = [0] * len(of.shape)
        for to, at in zip(left, index, strict=True):
            whole[to] = at
        return whole

    def view(place: View) -> View:
        strides = tuple(place.strides[a] for a in left)
        return View(place.buffer, place.offset, strides, op.outputs[0].shape)

    _moved(w, op, view, index_of)


def transpose(w: Writer, op: Op) -> None:
    order = op.params["permutation"]

    def index_of(index: Index) -> Index:
        whole: list[Any] = [0] * len(order)
        for to, at in zip(order, index, strict=True):
            whole[to] = at
        return whole

    def view(place: View) -> View:
        strides = tuple(place.strides[a] for a in order)
        return View(place.buffer, place.offset, strides, op.outputs[0].shape)

    _moved(w, op, view, index_of)


def sliced(w: Writer, op: Op) -> None:
    start = op.params["start_indices"]
    step = op.params["strides"] or (1,) * len(start)
    _part(w, op, op.inputs[0], op.outputs[0], start, step)


def split(w: Writer, op: Op) -> None:
    (of,), axis, start = op.inputs, op.params["axis"], 0
    for out in op.outputs:
        begin: list[str | int] = [0] * len(of.shape)
        begin[axis] = start
        start += out.shape[axis]
        _part(w, op, of, out, begin, (1,) * len(of.shape))


def dynamic_slice(w: Writer, op: Op) -> None:
    of, *starts = op.inputs
    begin = [
        _clamped(w, w.number(s), n - m)
        for s, n, m in zip(starts, of.shape, op.outputs[0].shape, strict=True)
    ]
    _part(w, op, of, op.outputs[0], begin, (1,) * len(begin))


def _clamped(w: Writer, start: str, most: int) -> str | int:
    if most == 0:
        return 0
    name = w.name("s")
    w.line(f"const int32_t {name} = tj_within({start}, {most});")
    return name


def _part(w: Writer, op: Op, of: Value, out: Value, start: Any, step: Any) -> None:
    place = w.place(of)

    def index_of(index: Index) -> Index:
        return [
            linear(s, (at,), (int(k),)) for s, at, k in zip(start, index, step, strict=True)
        ]

    if isinstance(place, View):
        offset = linear(place.offset, start, place.strides)
        strides = tuple(int(a * b) for a, b in zip(place.strides, step, strict=True))
        w.places[id(out)] = View(place.buffer, offset, strides, out.shape)
    else:
        w.set(out, lambda index: place.at(index_of(index)))


def reshape(w: Writer, op: Op) -> None:
    (of, *_), (out,) = op.inputs, op.outputs
    order = op.params.get("dimensions") if op.name == "reshape" else None
    if order is not None and tuple(order) != tuple(range(len(of.shape))):
        # JAX says with it that axes change places first.
        turned = Value(tuple(of.shape[a] for a in order), of.dtype)
        transpose(w, Op("transpose", {"permutation": order}, [of], [turned]))
        of = turned
    if of.size == 1:
        number = w.number(of)
        w.places[id(out)] = Lazy(out.shape, lambda _: number)
        return
    # Axes of length 1 come and go; all else needs elements one after the other.
    kept = [n for n in of.shape if n != 1]
    place = w.place(of)
    if kept == [n for n in out.shape if n != 1]:
        axes = [axis for axis, n in enumerate(of.shape) if n != 1]
        to = [axis for axis, n in enumerate(out.shape) if n != 1]
        if isinstance(place, View):
            strides = [0] * len(out.shape)
            for a, b in zip(axes, to, strict=True):
                strides[b] = place.strides[a]
            w.places[id(out)] = View(place.buffer, place.offset, tuple(strides), out.shape)
            return

        def index_of(index: Index) -> Index:
            whole: list[Any] = [0] * len(of.shape)
            for a, b in zip(axes, to, strict=True):
                whole[a] = index[b]
            return whole

        w.set(out, lambda index: place.at(index_of(index)))
        return
    view = w.contiguous(of)
    w.places[id(out)] = View(view.buffer, view.offset, row_major(out.shape), out.shape)


def concatenate(w: Writer, op: Op) -> None:
    (out,), axis = op.outputs, op.params["dimension"]
    target, start = w.target(out), 0
    for part in op.inputs:
        place, offset = w.place(part), start * target.strides[axis]
        shifted = View(target.buffer, offset, target.strides, part.shape)
        with w.loops(part.shape) as index:
            w.line(f"{shifted.at(index)} = {place.at(index)};")
        start += part.shape[axis]
    w.places[id(out)] = target


def pad(w: Writer, op: Op) -> None:
    (of, fill), (out,) = op.inputs, op.outputs
    config = [tuple(map(int, c)) for c in op.params["padding_config"]]
    if any(low < 0 or high < 0 for low, high, _ in config):
        raise ValueError("pad: got less than none, expected elements that are added")
    if all(c == (0, 0, 0) for c in config):
        w.places[id(out)] = w.place(of)
        return
    target, value, place = w.target(out), w.number(fill), w.place(of)
    with w.loops(out.shape) as index:
        w.line(f"{target.at(index)} = {value};")
    begin = [low for low, _, _ in config]
    offset = linear(0, begin, target.strides)
    strides = [s * (1 + gap) for s, (_, _, gap) in zip(target.strides, config, strict=True)]
    inner = View(target.buffer, offset, tuple(strides), of.shape)
    with w.loops(of.shape) as index:
        w.line(f"{inner.at(index)} = {place.at(index)};")
    w.places[id(out)] = target


def dynamic_update_slice(w: Writer, op: Op) -> None:
    (of, part, *starts), (out,) = op.inputs, op.outputs
    target = w.store(out, w.place(of))
    begin = [
        _clamped(w, w.number(s), n - m)
        for s, n, m in zip(starts, of.shape, part.shape, strict=True)
    ]
    inner = View(
        target.buffer, linear(0, begin, target.strides), target.strides, part.shape
    )
    place = w.place(part)
    with w.loops(part.shape) as index:
        w.line(f"{inner.at(index)} = {place.at(index)};")
    w.places[id(out)] = target


def reverse(w: Writer, op: Op) -> None:
    (of,), (out,) = op.inputs, op.outputs
    turned, place = set(op.params["dimensions"]), w.place(of)

    def read(index: Index) -> str:
        return place.at(
            [
                f"({out.shape[a] - 1} - ({i}))" if a in turned else i
                for a, i in enumerate(index)
            ]
        )

    w.set(out, read)


def iota(w: Writer, op: Op) -> None:
    (out,), axis = op.outputs, op.params["dimension"]
    w.set(out, lambda index: str(index[axis]))


MOVED = {
    "broadcast_in_dim": broadcast,
    "squeeze": squeeze,
    "transpose": transpose,
    "slice": sliced,
    "split": split,
    "dynamic_slice": dynamic_slice,
    "reshape": reshape,
    "expand_dims": reshape,
    "concatenate": concatenate,
    "pad": pad,
    "gather": gather,
    "scatter": scatter,
    "scatter-add": scatter,
    "scatter_add": scatter,
    "dynamic_update_slice": dynamic_update_slice,
    "rev": reverse,
    "iota": iota,
}

"""Writes branches and loops, and whole functions."""

from tomojax.native._elementwise import elementwise
from tomojax.native._moves import MOVED
from tomojax.native._places import c_type, Lazy, row_major, View
from tomojax.native._program import Body, Op, Value
from tomojax.native._sums import SUMS
from tomojax.native._tables import Tables
from tomojax.native._together import join_products
from tomojax.native._writer import ELEMENTWISE, Writer


def emit(w: Writer, op: Op) -> None:
    """Writes one operation.

    **Raises:** `ValueError` for an operation that has no C.
    """
    if op.name in ELEMENTWISE:
        elementwise(w, op)
    elif op.name in _OTHERS:
        _OTHERS[op.name](w, op)
    else:
        known = len(ELEMENTWISE) + len(_OTHERS)
        raise ValueError(f"operation: got {op.name}, expected one of {known} with C")


def _results(w: Writer, values: list[Value]) -> list[View]:
    return [w.target(v) for v in values]


def _copied(w: Writer, values: list[Value], targets: list[View]) -> None:
    for value, target in zip(values, targets, strict=True):
        place = w.place(value)
        with w.loops(value.shape) as index:
            w.line(f"{target.at(index)} = {place.at(index)};")


def cond(w: Writer, op: Op) -> None:
    (index,), bodies = op.inputs, op.bodies
    results = _results(w, op.outputs)
    which = w.name("s")
    w.line(f"const int32_t {which} = tj_within({w.number(index)}, {len(bodies) - 1});")
    for k, body in enumerate(bodies):
        asked = f"if ({which} == {k})" if k == 0 else f"else if ({which} == {k})"
        with w.block("else" if k == len(bodies) - 1 else asked):
            w.body(body, emit)
            _copied(w, body.outputs, results)
    for value, view in zip(op.outputs, results, strict=True):
        w.places[id(value)] = view


def scan(w: Writer, op: Op) -> None:
    (body,), count, length = op.bodies, op.params["carry"], op.params["length"]
    carried, rows = op.inputs[:count], [w.stored(v) for v in op.inputs[count:]]
    state = [w.store(v, w.place(v)) for v in carried]
    results = _results(w, op.outputs[count:])
    for view in results:
        w.begin(view)
    i = w.name("i")
    at = f"({length - 1} - {i})" if op.params["reverse"] else i
    with w.repeated(f"for (int {i} = 0; {i} < {length}; {i}++)"):
        for value, view in zip(body.inputs[:count], state, strict=True):
            w.places[id(value)] = view
        for value, view in zip(body.inputs[count:], rows, strict=True):
            w.places[id(value)] = _row(view, at)
        w.body(body, emit)
        # Rows first: they may be of the state as it was.
        _copied(w, body.outputs[count:], [_row(v, at) for v in results])
        _carry(w, body.outputs[:count], state)
    for value, view in zip(op.outputs, state + results, strict=True):
        w.places[id(value)] = view


def _row(view: View, at: str) -> View:
    offset = f"{view.offset} + ({at})*{view.strides[0]}"
    return View(view.buffer, offset, view.strides[1:], view.shape[1:])


def _carry(w: Writer, values: list[Value], state: list[View]) -> None:
    """Copies the next state: by way of memory of its own, as one may be of another."""
    moved = [(v, s) for v, s in zip(values, state, strict=True) if w.place(v) is not s]
    kept = [w.store(v, w.place(v)) for v, _ in moved]
    for (value, view), new in zip(moved, kept, strict=True):
        with w.loops(value.shape) as index:
            w.line(f"{view.at(index)} = {new.at(index)};")


def while_(w: Writer, op: Op) -> None:
    asked, done = op.bodies
    state = [w.store(v, w.place(v)) for v in op.inputs]
    for value, view in zip(done.inputs, state, strict=True):
        w.places[id(value)] = view
    with w.repeated("for (;;)"):
        w.body(asked, emit)
        w.line(f"if (!{w.number(asked.outputs[0])}) break;")
        w.body(done, emit)
        _carry(w, done.outputs, state)
    for value, view in zip(op.outputs, state, strict=True):
        w.places[id(value)] = view


_OTHERS = {**MOVED, **SUMS, "cond": cond, "scan": scan, "while": while_}


def function(name: str, body: Body, tables: Tables) -> str:
    """Writes a program as C: `void name(const char *T, inputs ..., outputs ...)`.

    All but T, the tables, are pointers to arrays. Outputs are written last: they may lie
    where inputs do.

    **Raises:** `ValueError` for an operation that has no C.

    **Example:**

    >>> import numpy as np
    >>> from tomojax.native import function, program_of, Tables
    >>> body = program_of(lambda a: (2 * a,), np.zeros(3, np.float32))
    >>> print(function("twice", body, Tables()))
    static void twice(
        const char *T, const float *in0, float *out0) {
    float m0[3] TJ_ALIGNED;
    for (int i1 = 0; i1 < 3; i1++) {
    m0[i1] = (2.0f * in0[i1]);
    }
    for (int i2 = 0; i2 < 3; i2++) {
    out0[i2] = m0[i2];
    }
    }
    """
    join_products(body)
    w = Writer(tables)
    w.count(body)
    arguments = ["const char *T"]
    for k, value in enumerate(body.inputs):
        arguments.append(f"const {c_type(value.dtype)} *in{k}")
        w.places[id(value)] = View(f"in{k}", 0, row_major(value.shape), value.shape)
    w.body(body, emit)
    stored = [_own(w, v) for v in body.outputs]
    for k, (value, view) in enumerate(zip(body.outputs, stored, strict=True)):
        arguments.append(f"{c_type(value.dtype)} *out{k}")
        with w.loops(value.shape) as index:
            to = View(f"out{k}", 0, row_major(value.shape), value.shape)
            w.line(f"{to.at(index)} = {view.at(index)};")
    return f"static void {name}(\n    {', '.join(arguments)}) {{\n{w.text()}\n}}\n"


def _own(w: Writer, value: Value) -> View:
    """Returns an output apart from all inputs: it may be written over them."""
    place = w.place(value)
    if isinstance(place, Lazy) or place.buffer.startswith("in"):
        return w.store(value, place)
    return place

"""Writes operations that work on each element by itself."""

from collections.abc import Callable

import numpy as np

from tomojax.native._places import c_type, Index, literal
from tomojax.native._program import Op
from tomojax.native._writer import ELEMENTWISE, Writer


def _function(name: str) -> Callable:
    """Returns one of C's functions, by the number's width."""

    def write(op: Op, *args: str) -> str:
        double = op.inputs[-1].dtype == np.float64
        return f"{name}{'' if double else 'f'}({', '.join(args)})"

    return write


def _operator(sign: str) -> Callable:
    """Returns an operator; whole numbers wrap around, as XLA's do."""

    def write(op: Op, a: str, b: str) -> str:
        dtype = op.outputs[0].dtype
        if dtype.kind == "i":
            kind = c_type(dtype)
            return f"({kind})((u{kind}){a} {sign} (u{kind}){b})"
        return f"({a} {sign} {b})"

    return write


def _compared(sign: str) -> Callable:
    return lambda op, a, b: f"({a} {sign} {b})"


def _typed(name: str) -> Callable:
    """Returns a function of the prelude, by type."""
    return lambda op, *args: f"{name}_{c_type(op.inputs[-1].dtype)}({', '.join(args)})"


def _power(op: Op, a: str) -> str:
    """Writes a whole power as products, in the order that XLA multiplies in."""
    y = op.params["y"]
    dtype = op.inputs[0].dtype
    one = literal(1, dtype)
    if y == 0:
        return one
    kind = c_type(dtype)
    if abs(y) == 1:
        text = a
    elif abs(y) == 2:
        text = f"tj_square_{kind}({a})"
    else:
        text = f"tj_whole_power_{kind}({a}, {abs(y)})"
    return f"({one} / {text})" if y < 0 else text


def _div(op: Op, a: str, b: str) -> str:
    if op.outputs[0].dtype.kind == "f":
        return f"({a} / {b})"
    return f"tj_div_{c_type(op.outputs[0].dtype)}({a}, {b})"


def _rem(op: Op, a: str, b: str) -> str:
    if op.outputs[0].dtype.kind == "f":
        return _function("fmod")(op, a, b)
    return f"tj_rem_{c_type(op.outputs[0].dtype)}({a}, {b})"


def _converted(op: Op, a: str) -> str:
    """Converts as XLA does: a float that no whole number is becomes the nearest."""
    of, to = op.inputs[0].dtype, op.outputs[0].dtype
    if of == to:
        return a
    if to == np.bool_:
        return f"({a} != 0)"
    if of.kind == "f" and to.kind in "iu":
        return f"tj_to_{c_type(to)}({a})"
    return f"({c_type(to)})({a})"


def _not(op: Op, a: str) -> str:
    return f"(!{a})" if op.inputs[0].dtype == np.bool_ else f"(~{a})"


def _abs(op: Op, a: str) -> str:
    if op.inputs[0].dtype.kind == "f":
        return _function("fabs")(op, a)
    return f"({a} < 0 ? -{a} : {a})"


def _sign(op: Op, a: str) -> str:
    return f"tj_sign_{c_type(op.inputs[0].dtype)}({a})"


def _round(op: Op, a: str) -> str:
    even = int(op.params["rounding_method"]) == 1
    return _function("rint" if even else "round")(op, a)


def _select(op: Op, which: str, *cases: str) -> str:
    text = cases[-1]
    for at in range(len(cases) - 2, -1, -1):
        asked = f"!{which}" if len(cases) == 2 else f"{which} <= {at}"
        # C evaluates both cases, so that compilers choose among lanes and do not branch.
        text = f"tj_either_{c_type(op.outputs[0].dtype)}({asked}, {cases[at]}, {text})"
    return text


def _clamp(op: Op, low: str, a: str, high: str) -> str:
    kind = c_type(op.inputs[1].dtype)
    return f"tj_min_{kind}(tj_max_{kind}({a}, {low}), {high})"


def _bits(op: Op, a: str) -> str:
    of, to = (c_type(v.dtype) for v in (op.inputs[0], op.outputs[0]))
    return f"tj_bits_{of}_{to}({a})"


def _extreme(name: str) -> Callable:
    """Returns the larger or the smaller; for truths these are *or* and *and*."""

    def write(op: Op, a: str, b: str) -> str:
        return f"tj_{name}_{c_type(op.outputs[0].dtype)}({a}, {b})"

    return write


ELEMENTWISE.update(
    add=_operator("+"), add_any=_operator("+"), sub=_operator("-"), mul=_operator("*"),
    div=_div, rem=_rem, neg=lambda op, a: f"(-{a})", abs=_abs, sign=_sign,
    max=_extreme("max"), min=_extreme("min"), clamp=_clamp,
    integer_pow=_power, square=lambda op, a: f"tj_square_{c_type(op.inputs[0].dtype)}({a})",
    pow=_function("pow"), sqrt=_function("sqrt"), exp=_function("exp"),
    rsqrt=lambda op, a: f"({literal(1, op.inputs[0].dtype)} / {_function('sqrt')(op, a)})",
    exp2=_function("exp2"), log=_function("log"), log1p=_function("log1p"),
    expm1=_function("expm1"), sin=_function("sin"), cos=_function("cos"),
    tan=_function("tan"), atan2=_function("atan2"), tanh=_function("tanh"),
    erf=_function("erf"), floor=_function("floor"), ceil=_function("ceil"), round=_round,
    is_finite=lambda op, a: f"(isfinite({a}) != 0)",
    lt=_compared("<"), le=_compared("<="), gt=_compared(">"), ge=_compared(">="),
    eq=_compared("=="), ne=_compared("!="), convert_element_type=_converted,
    select_n=_select, bitcast_convert_type=_bits, **{"not": _not},
    **{n: _compared(s) for n, s in (("and", "&"), ("or", "|"), ("xor", "^"))},
)  # fmt: skip


def elementwise(w: Writer, op: Op) -> None:
    """Writes an operation on each element; numbers go with all elements of arrays."""
    (out,) = op.outputs
    write = ELEMENTWISE[op.name]
    places = [(w.place(v), v.shape) for v in op.inputs]

    def read(index: Index) -> str:
        # A number goes with all elements, as an axis of length 1 does.
        args = [
            place.at([0 if n == 1 else i for n, i in zip(shape, index)])
            for place, shape in places
        ]
        return write(op, *args)

    w.set(out, read)

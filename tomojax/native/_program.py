"""Makes a program of a traced function: one list of operations, calls inlined.

What is known before it runs is worked out once: what follows from shapes alone becomes part
of the code, what follows from constants becomes part of the tables.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.extend as jex
import numpy as np

# Operations that only say where a value's elements are.
MOVES = "broadcast_in_dim", "reshape", "squeeze", "transpose", "expand_dims", "slice"

# Operations that are calls of a function, and the parameter that holds it.
_CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "remat2": "jaxpr",
    "checkpoint": "jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "custom_vmap_call": "call",
}
_SAME = "optimization_barrier", "stop_gradient", "copy", "copy_p"


@dataclass(eq=False, slots=True)
class Value:
    """An array of the program, or a number."""

    shape: tuple[int, ...]
    dtype: np.dtype
    known: np.ndarray | None = None  # where it is part of the code or the tables
    origin: Any = None  # the array that was given, where it is a constant of a closure
    told: bool = False  # whether it follows from shapes alone
    made_by: "Op | None" = None

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))


@dataclass(eq=False, slots=True)
class Op:
    """An operation of the program; loops and branches have bodies."""

    name: str
    params: dict[str, Any]
    inputs: list[Value]
    outputs: list[Value]
    bodies: list["Body"] = field(default_factory=list)
    primitive: Any = None

    def reads(self) -> Iterator[Value]:
        """Yields the values that the operation reads from outside."""
        yield from self.inputs
        for body in self.bodies:
            inside = set(map(id, body.inputs))
            for op in body.ops:
                for value in op.reads():
                    if id(value) not in inside:
                        yield value
                inside |= set(map(id, op.outputs))
            yield from (v for v in body.outputs if id(v) not in inside)


@dataclass(eq=False, slots=True)
class Body:
    """A list of operations with its own inputs and its outputs."""

    inputs: list[Value]
    ops: list[Op]
    outputs: list[Value]

    @property
    def count(self) -> int:
        """How many operations there are, those of loops and branches too."""
        return sum(1 + sum(inner.count for inner in op.bodies) for op in self.ops)


def program_of(f: Callable, *examples: Any) -> Body:
    """Traces `f`, of arrays to a tuple of arrays; drops what nobody reads.

    **Example:**

    >>> import numpy as np
    >>> from tomojax.native import program_of
    >>> body = program_of(lambda a, b: (a + b, a.sum()), np.zeros(3), np.zeros(3))
    >>> [op.name for op in body.ops], [value.shape for value in body.outputs]
    (['add', 'reduce_sum'], [(3,), ()])
    """
    closed = jax.make_jaxpr(f)(*examples)
    constants = [_constant(c, False) for c in closed.consts]
    inputs = [_fresh(v.aval) for v in closed.jaxpr.invars]
    ops: list[Op] = []
    outputs = _inline(closed.jaxpr, constants + inputs, ops, {})
    body = Body(inputs, ops, outputs)
    _fold(body)
    _drop_unread(body)
    return body


def _fresh(aval: Any) -> Value:
    return Value(tuple(map(int, aval.shape)), np.dtype(aval.dtype))


def _constant(array: Any, told: bool) -> Value:
    values = np.asarray(array)
    return Value(values.shape, values.dtype, values, array, told)


def _inline(jaxpr: Any, given: Sequence[Value], ops: list[Op], seen: dict) -> list[Value]:
    """Appends the operations of `jaxpr` to `ops`; returns its outputs."""
    names = [*jaxpr.constvars, *jaxpr.invars]
    values: dict[Any, Value] = dict(zip(names, given, strict=True))

    def read(v: Any) -> Value:
        if isinstance(v, jex.core.Literal):
            dtype = v.aval.dtype  # pyright: ignore (of a shaped value)
            return _constant(np.asarray(v.val, dtype), True)
        return values[v]

    for equation in jaxpr.eqns:
        name, params = equation.primitive.name, equation.params
        args = [read(v) for v in equation.invars]
        results = _special(name, params, args, ops, seen)
        if results is None:
            results = _once(equation, args, ops, seen)
        values.update(zip(equation.outvars, results, strict=True))
    return [read(v) for v in jaxpr.outvars]


def _special(
    name: str, params: dict, args: list[Value], ops: list[Op], seen: dict
) -> list[Value] | None:
    """Inlines calls; gives branches and loops their bodies. None for all else."""
    if name in _SAME:
        return args
    if name in _CALLS:
        return _closed(params[_CALLS[name]], args, ops, seen)
    if name == "custom_linear_solve":
        lengths = params["const_lengths"]
        start = lengths.matvec + lengths.vecmat
        solve = args[start : start + lengths.solve]
        right = args[sum(lengths) :]
        return _closed(params["jaxprs"].solve, solve + right, ops, seen)
    if name == "platform_index":
        told = [p is None or "cpu" in p for p in params["platforms"]]
        return [_constant(np.int32(told.index(True)), True)]
    if name == "cond":
        index, *rest = args
        branches = params["branches"]
        if index.known is not None:
            at = int(np.clip(index.known, 0, len(branches) - 1))
            return _closed(branches[at], rest, ops, seen)
        bodies = [_body(b, [], rest, seen) for b in branches]
        return _made("cond", {}, [index], branches[0].out_avals, bodies, ops)
    if name == "scan":
        return _scan(params, args, ops, seen)
    if name == "while":
        a, b = params["cond_nconsts"], params["body_nconsts"]
        state = [_fresh(v) for v in params["body_jaxpr"].out_avals]
        asked = _body(params["cond_jaxpr"], state, args[:a] + state, seen)
        done = _body(params["body_jaxpr"], state, args[a : a + b] + state, seen)
        out = params["body_jaxpr"].out_avals
        return _made("while", {}, args[a + b :], out, [asked, done], ops)
    return None


def _scan(params: dict, args: list[Value], ops: list[Op], seen: dict) -> list[Value]:
    inner, k, c = params["jaxpr"], params["num_consts"], params["num_carry"]
    fresh = [_fresh(v) for v in inner.in_avals[k:]]
    body = _body(inner, fresh, args[:k] + fresh, seen)
    length = params["length"]
    out = [
        jax.ShapeDtypeStruct(a.shape if i < c else (length, *a.shape), a.dtype)
        for i, a in enumerate(inner.out_avals)
    ]
    about = {"length": length, "carry": c, "reverse": params["reverse"]}
    return _made("scan", about, args[k:], out, [body], ops)


def _made(name: str, params: dict, args: list, out: Any, bodies: list, ops: list) -> list:
    op = Op(name, params, args, [_fresh(a) for a in out], bodies)
    for value in op.outputs:
        value.made_by = op
    ops.append(op)
    return op.outputs


def _closed(closed: Any, args: list[Value], ops: list[Op], seen: dict) -> list[Value]:
    jaxpr = getattr(closed, "jaxpr", closed)
    consts = [_constant(c, False) for c in getattr(closed, "consts", ())]
    return _inline(jaxpr, consts + args, ops, seen)


def _body(closed: Any, inputs: list[Value], args: list[Value], seen: dict) -> Body:
    ops: list[Op] = []
    outputs = _closed(closed, args, ops, dict(seen))
    return Body(inputs, ops, outputs)


def _once(equation: Any, args: list[Value], ops: list[Op], seen: dict) -> list[Value]:
    """Appends an operation, or finds the same one again."""
    inside = any(
        hasattr(p, "eqns") or hasattr(p, "jaxpr") for p in equation.params.values()
    )
    about = str(equation.params) if not inside else id(equation)
    which = [
        (a.dtype.str, a.known.tobytes())
        if a.told and a.size == 1 and a.known is not None
        else id(a)
        for a in args
    ]
    key = equation.primitive.name, about, *which
    # A value that went would leave its name to another.
    seen.setdefault("held", []).append((args, equation))
    op = seen.get(key)
    if op is None:
        outputs = [_fresh(v.aval) for v in equation.outvars]
        name, primitive = equation.primitive.name, equation.primitive
        op = Op(name, dict(equation.params), args, outputs, primitive=primitive)
        for value in outputs:
            value.made_by = op
        ops.append(op)
        seen[key] = op
    return op.outputs


def _fold(body: Body) -> None:
    """Works out what is known, in one compiled call."""
    known: list[Op] = []
    of: set[int] = set()

    def is_known(value: Value) -> bool:
        return value.known is not None or id(value) in of

    def split(some: Body) -> None:
        left = []
        for op in some.ops:
            if not op.bodies and op.primitive is not None and all(map(is_known, op.inputs)):
                known.append(op)
                of.update(map(id, op.outputs))
                told = all(v.told for v in op.inputs)
                for value in op.outputs:
                    value.told = told
            else:
                left.append(op)
            for inner in op.bodies:
                split(inner)
        some.ops = left

    split(body)
    # A value that is another one moved is read where that other one is.
    needed: dict[int, Value] = {}
    kept: set[int] = set()

    def need(value: Value) -> None:
        op = value.made_by
        if value.known is not None or id(value) not in of or op is None:
            return
        if op.name in MOVES and value.size > 16:
            kept.add(id(op))
            need(op.inputs[0])
        else:
            needed[id(value)] = value

    def ask(some: Body) -> None:
        for op in some.ops:
            for value in op.inputs:
                need(value)
            for inner in op.bodies:
                ask(inner)
        for value in some.outputs:
            need(value)

    ask(body)
    _evaluate(known, list(needed.values()))
    body.ops = [op for op in known if id(op) in kept] + body.ops


def _evaluate(known: list[Op], needed: list[Value]) -> None:
    constants = {id(v): v for op in known for v in op.inputs if v.known is not None}

    def run(given: dict[int, Any]) -> list[Any]:
        env = dict(given)
        for op in known:
            out = op.primitive.bind(*(env[id(v)] for v in op.inputs), **op.params)
            outs = out if op.primitive.multiple_results else [out]
            env.update({id(v): o for v, o in zip(op.outputs, outs)})
        return [env[id(v)] for v in needed]

    arrays = {k: v.known for k, v in constants.items()}
    for value, array in zip(needed, jax.jit(run)(arrays) if needed else []):
        value.known = np.asarray(array)


def _drop_unread(body: Body) -> None:
    """Removes operations whose results nobody reads."""
    read = set(map(id, body.outputs))

    def walk(some: Body) -> None:
        left = []
        for op in reversed(some.ops):
            if not any(id(v) in read for v in op.outputs):
                continue
            read.update(map(id, op.inputs))
            for inner in op.bodies:
                read.update(map(id, inner.outputs))
                walk(inner)
            left.append(op)
        some.ops = left[::-1]

    walk(body)

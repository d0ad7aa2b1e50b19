"""Joins products of vectors with one matrix, so that it is read once."""

from tomojax.native._program import Body, Op

# Vectors of one pass: with two registers of sums each, they fit into sixteen.
_MOST = 7

# Fewer columns than this are not worth it.
_LANES = 16

# Rows up to this long, of a matrix that is used once, are read in blocks. A larger matrix
# does not stay in a core's cache, which reads ahead along rows; one of this size does, if
# each slot reads the same.
_WIDE = 512
_STAYS = 1 << 18  # bytes


def join_products(body: Body) -> None:
    """Joins products of vectors with a matrix, up to where the first of them is read."""
    for op in body.ops:
        for inner in op.bodies:
            join_products(inner)
    waiting: dict[int, list[Op]] = {}
    joined: list[Op] = []

    def close(key: int) -> None:
        some = waiting.pop(key)
        inputs = [some[0].inputs[1], *(op.inputs[0] for op in some)]
        outputs = [op.outputs[0] for op in some]
        stays = inputs[0].known is not None and inputs[0].known.nbytes <= _STAYS
        alone = len(some) == 1 and inputs[0].shape[1] > _WIDE and not stays
        one = some[0] if alone else Op("dots", {}, inputs, outputs)
        joined.append(one)

    for op in body.ops:
        read = set(map(id, op.reads()))
        for key, some in list(waiting.items()):
            if any(id(one.outputs[0]) in read for one in some):
                close(key)
        if not _of_vector(op):
            joined.append(op)
            continue
        key = id(op.inputs[1])
        waiting.setdefault(key, []).append(op)
        if len(waiting[key]) == _MOST:
            close(key)
    for key in list(waiting):
        close(key)
    body.ops = joined


def _of_vector(op: Op) -> bool:
    if op.name != "dot_general":
        return False
    vector, matrix = op.inputs
    along = op.params["dimension_numbers"] == (((0,), (0,)), ((), ()))
    wide = len(matrix.shape) == 2 and matrix.shape[1] >= _LANES
    return along and wide and len(vector.shape) == 1

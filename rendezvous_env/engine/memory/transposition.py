"""Transposition of a matrix by tiles of four by four numbers in registers."""

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from ...compilation import compiled

TILE = 4
"""Rows and columns of a tile."""
_EVEN, _ODD = (0, 4, 2, 6), (1, 5, 3, 7)  # elements of two vectors, those of the second from 4 on
_LOW, _HIGH = (0, 1, 4, 5), (2, 3, 6, 7)


def _transpose_in_python(source, start, width, target, begin, length):
    for row in range(TILE):
        for column in range(TILE):
            target[begin + column * length + row] = source[start + row * width + column]


def _transpose_in_registers(
    _: Any, source: Any, start: Any, width: Any, target: Any, begin: Any, length: Any
) -> Any:
    """Signature, and generator of code with a vector for each row of a tile."""
    vector = ir.VectorType(ir.DoubleType(), TILE)

    def joined(builder: Any, one: Any, other: Any, order: tuple[int, ...]) -> Any:
        mask = ir.Constant(ir.VectorType(ir.IntType(32), TILE), list(order))
        return builder.shuffle_vector(one, other, mask)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def rows(place: int) -> list[Any]:
            matrix, first, step = arguments[place : place + 3]
            data = context.make_array(signature.args[place])(context, builder, matrix).data
            starts = [builder.add(first, builder.mul(step, step.type(k))) for k in range(TILE)]
            found = [builder.gep(data, [start]) for start in starts]
            return [builder.bitcast(address, vector.as_pointer()) for address in found]

        a, b, c, d = (builder.load(row, align=8) for row in rows(0))
        pairs = [
            (joined(builder, a, b, order), joined(builder, c, d, order)) for order in (_EVEN, _ODD)
        ]
        columns = [joined(builder, *pair, half) for half in (_LOW, _HIGH) for pair in pairs]
        for column, row in zip(columns, rows(3), strict=True):
            builder.store(column, row, align=8)
        return context.get_dummy_value()

    return types.void(source, start, width, target, begin, length), generate


transpose_tile: Any = intrinsic(_transpose_in_registers) if compiled() else _transpose_in_python
"""Copy a tile of a matrix to its transpose, both flat arrays of float64.

LLVM itself would store the numbers one after another, which takes three times as long.

Args:
    source: matrix.
    start: index of the first number of the tile.
    width: numbers in a row of ``source``.
    target: transposed matrix.
    begin: index of the first number of the transposed tile.
    length: numbers in a row of ``target``.
"""

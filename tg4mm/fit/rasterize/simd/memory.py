"""Memory: loads and stores of vectors and numbers, prefetches, an atomic counter.

A place is a contiguous array, or the address of one (`address`). Loops that take arrays from tuples or slice them pay
for numba's reference counting, two calls for each, with all vector registers saved around them; addresses are plain
integers. Nothing is checked.
"""

from llvmlite import ir
from numba import types

from tg4mm.fit.rasterize.simd.vector import (
    F32,
    FV,
    I32,
    I64,
    IV,
    LANES,
    as_lanes,
    declare,
    half,
    instruction,
    pixels,
    vector,
)

_NEAR, _FAR = 3, 2  # where prefetched lines go: the first cache, the second


def data_at(context, builder, kind, place):
    """Pointer to the first float32 of an array, or of what lies at an address."""
    if isinstance(kind, types.Integer):
        return builder.inttoptr(place, F32.as_pointer())
    return context.make_array(kind)(context, builder, place).data


def _entry(context, builder, sig, args, kind=F32):
    """Pointer to entry args[1] of the place args[0]."""
    data = builder.bitcast(data_at(context, builder, sig.args[0], args[0]), kind.as_pointer())
    return builder.gep(data, [args[1]])


def _contiguous(place):
    return isinstance(place, types.Integer) or getattr(place, "layout", None) == "C"


@instruction(
    lambda array: types.int64(array) if _contiguous(array) and array.dtype.bitwidth in (16, 32) else None
)
def address(context, builder, sig, args):
    """The address of a contiguous array of 32- or 16-bit numbers.

    An array made in the kernel must be used once more after the last access (`keep`), or it is freed before; arrays
    that are the kernel's arguments are held by the caller.
    """
    return builder.ptrtoint(data_at(context, builder, sig.args[0], args[0]), I64)


@instruction(lambda array: types.none(array))
def keep(context, builder, sig, args):
    """Does nothing, but keeps the array alive until here."""


def _loading(kind):
    """Lanes from a place, from float32 `index` on (int64, not checked)."""

    @instruction(lambda place, index: kind(place, types.int64))
    def loading(context, builder, sig, args):
        entry = _entry(context, builder, sig, args)
        return builder.load(builder.bitcast(entry, ir.VectorType(F32, kind.lanes).as_pointer()), align=4)

    return loading


load, load_half = _loading(vector), _loading(half)
load_pixels = load if pixels == vector else load_half


@instruction(lambda place, index, value: types.none(place, types.int64, value))
def store(context, builder, sig, args):
    """Lanes to a place, from float32 `index` on (int64, not checked)."""
    entry = _entry(context, builder, sig, args)
    builder.store(args[2], builder.bitcast(entry, args[2].type.as_pointer()), align=4)


def _first(builder, count):
    """Mask of the first `count` lanes; none if it is not positive."""
    numbered = ir.Constant(IV, [ir.Constant(I32, k) for k in range(LANES)])
    return builder.icmp_signed("<", numbered, as_lanes(builder, builder.trunc(count, I32)))


@instruction(lambda place, index, count: vector(place, types.int64, types.int64))
def load_first(context, builder, sig, args):
    """`load` of the first `count` lanes (int64), the others 0; of these no memory is read."""
    there, at = _first(builder, args[2]), FV.as_pointer()
    f = declare(builder, "llvm.masked.load.v16f32.p0", FV, [at, I32, there.type, FV])
    entry = builder.bitcast(_entry(context, builder, sig, args), at)
    return builder.call(f, [entry, ir.Constant(I32, 4), there, ir.Constant(FV, None)])


@instruction(lambda place, index, count, value: types.none(place, types.int64, types.int64, vector))
def store_first(context, builder, sig, args):
    """`store` of the first `count` lanes."""
    there, at = _first(builder, args[2]), FV.as_pointer()
    f = declare(builder, "llvm.masked.store.v16f32.p0", ir.VoidType(), [FV, at, I32, there.type])
    entry = builder.bitcast(_entry(context, builder, sig, args), at)
    builder.call(f, [args[3], entry, ir.Constant(I32, 4), there])


@instruction(lambda place, index: types.float32(place, types.int64) if _contiguous(place) else None)
def number(context, builder, sig, args):
    """The float32 `index` of a place, counted through all its dimensions, not checked."""
    return builder.load(_entry(context, builder, sig, args), align=4)


@instruction(lambda place, index, value: types.none(place, types.int64, types.float32))
def put_number(context, builder, sig, args):
    """Write what `number` reads."""
    builder.store(args[2], _entry(context, builder, sig, args), align=4)


@instruction(lambda at, index: types.uint32(types.int64, types.int64))
def integer(context, builder, sig, args):
    """The uint32 `index` from an address on, not checked."""
    return builder.load(_entry(context, builder, sig, args, I32), align=4)


@instruction(lambda at, index, value: types.none(types.int64, types.int64, types.uint32))
def put_integer(context, builder, sig, args):
    """Write what `integer` reads."""
    builder.store(args[2], _entry(context, builder, sig, args, I32), align=4)


def _prefetch(builder, pointer, level):
    kind = ir.IntType(8).as_pointer()
    f = declare(builder, "llvm.prefetch.p0", ir.VoidType(), [kind, I32, I32, I32])
    hints = [ir.Constant(I32, x) for x in (0, level, 1)]  # to read, data
    builder.call(f, [builder.bitcast(pointer, kind), *hints])


def _prefetching(level):
    """Prefetch the cache line of float32 `index` of a place."""

    @instruction(lambda place, index: types.none(place, types.int64))
    def prefetching(context, builder, sig, args):
        _prefetch(builder, _entry(context, builder, sig, args), level)

    return prefetching


prefetch, prefetch_far = _prefetching(_NEAR), _prefetching(_FAR)  # far: for later use


@instruction(lambda array, row: types.none(array, types.int64))
def prefetch_row(context, builder, sig, args):
    """Prefetch the first cache line of a row of the C-ordered array [n, m], into the first cache."""
    made = context.make_array(sig.args[0])(context, builder, args[0])
    stride = builder.extract_value(made.strides, 0)
    at = builder.add(builder.ptrtoint(made.data, I64), builder.mul(args[1], stride))
    _prefetch(builder, builder.inttoptr(at, F32.as_pointer()), _NEAR)


@instruction(lambda array: types.int64(array))
def fetch_add(context, builder, sig, args):
    """Atomically add 1 to the first entry of an int64 array and return the old value: a thread takes its next item."""
    data = context.make_array(sig.args[0])(context, builder, args[0]).data
    return builder.atomic_rmw("add", data, ir.Constant(I64, 1), "monotonic")

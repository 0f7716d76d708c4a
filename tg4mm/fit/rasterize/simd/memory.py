"""Memory: loads and stores of vectors and numbers, prefetches, an atomic counter.

A place is a contiguous array, or the address of one (`address`). Loops that take arrays from tuples or slice them pay
for numba's reference counting, two calls for each, with all vector registers saved around them; addresses are plain
integers. Nothing is checked.
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

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


@intrinsic
def address(typingctx, array):
    """The address of a contiguous array of 32- or 16-bit numbers.

    An array made in the kernel must be used once more after the last access (`keep`), or it is freed before; arrays
    that are the kernel's arguments are held by the caller.
    """

    def codegen(context, builder, sig, args):
        return builder.ptrtoint(data_at(context, builder, sig.args[0], args[0]), I64)

    is_known = _contiguous(array) and array.dtype.bitwidth in (16, 32)
    return (types.int64(array), codegen) if is_known else None


@intrinsic
def keep(typingctx, array):
    """Does nothing, but keeps the array alive until here."""
    return types.none(array), lambda context, builder, sig, args: context.get_dummy_value()


def _loading(kind):
    """Lanes from a place, from float32 `index` on (int64, not checked)."""

    def typed(typingctx, place, index):
        def codegen(context, builder, sig, args):
            entry = _entry(context, builder, sig, args)
            lanes = ir.VectorType(F32, kind.lanes)
            return builder.load(builder.bitcast(entry, lanes.as_pointer()), align=4)

        return kind(place, types.int64), codegen

    return intrinsic(typed)


load, load_half = _loading(vector), _loading(half)
load_pixels = load if pixels == vector else load_half


@intrinsic
def store(typingctx, place, index, value):
    """Lanes to a place, from float32 `index` on (int64, not checked)."""

    def codegen(context, builder, sig, args):
        entry = _entry(context, builder, sig, args)
        builder.store(args[2], builder.bitcast(entry, args[2].type.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.none(place, types.int64, value), codegen


def _first(builder, count):
    """Mask of the first `count` lanes; none if it is not positive."""
    numbered = ir.Constant(IV, [ir.Constant(I32, k) for k in range(LANES)])
    return builder.icmp_signed("<", numbered, as_lanes(builder, builder.trunc(count, I32)))


@intrinsic
def load_first(typingctx, place, index, count):
    """`load` of the first `count` lanes (int64), the others 0; of these no memory is read."""

    def codegen(context, builder, sig, args):
        there, at = _first(builder, args[2]), FV.as_pointer()
        f = declare(builder, "llvm.masked.load.v16f32.p0", FV, [at, I32, there.type, FV])
        entry = builder.bitcast(_entry(context, builder, sig, args), at)
        return builder.call(f, [entry, ir.Constant(I32, 4), there, ir.Constant(FV, None)])

    return vector(place, types.int64, types.int64), codegen


@intrinsic
def store_first(typingctx, place, index, count, value):
    """`store` of the first `count` lanes."""

    def codegen(context, builder, sig, args):
        there, at = _first(builder, args[2]), FV.as_pointer()
        f = declare(builder, "llvm.masked.store.v16f32.p0", ir.VoidType(), [FV, at, I32, there.type])
        entry = builder.bitcast(_entry(context, builder, sig, args), at)
        builder.call(f, [args[3], entry, ir.Constant(I32, 4), there])
        return context.get_dummy_value()

    return types.none(place, types.int64, types.int64, vector), codegen


@intrinsic
def number(typingctx, place, index):
    """The float32 `index` of a place, counted through all its dimensions, not checked."""

    def codegen(context, builder, sig, args):
        return builder.load(_entry(context, builder, sig, args), align=4)

    return (types.float32(place, types.int64), codegen) if _contiguous(place) else None


@intrinsic
def put_number(typingctx, place, index, value):
    """Write what `number` reads."""

    def codegen(context, builder, sig, args):
        builder.store(args[2], _entry(context, builder, sig, args), align=4)
        return context.get_dummy_value()

    return types.none(place, types.int64, types.float32), codegen


@intrinsic
def integer(typingctx, at, index):
    """The uint32 `index` from an address on, not checked."""

    def codegen(context, builder, sig, args):
        return builder.load(_entry(context, builder, sig, args, I32), align=4)

    return types.uint32(types.int64, types.int64), codegen


@intrinsic
def put_integer(typingctx, at, index, value):
    """Write what `integer` reads."""

    def codegen(context, builder, sig, args):
        builder.store(args[2], _entry(context, builder, sig, args, I32), align=4)
        return context.get_dummy_value()

    return types.none(types.int64, types.int64, types.uint32), codegen


def _prefetch(builder, pointer, level):
    kind = ir.IntType(8).as_pointer()
    f = declare(builder, "llvm.prefetch.p0", ir.VoidType(), [kind, I32, I32, I32])
    hints = [ir.Constant(I32, x) for x in (0, level, 1)]  # to read, data
    builder.call(f, [builder.bitcast(pointer, kind), *hints])


def _prefetching(level):
    def codegen(context, builder, sig, args):
        _prefetch(builder, _entry(context, builder, sig, args), level)
        return context.get_dummy_value()

    return codegen


@intrinsic
def prefetch(typingctx, place, index):
    """Prefetch the cache line of float32 `index` of a place, into the first cache."""
    return types.none(place, types.int64), _prefetching(_NEAR)


@intrinsic
def prefetch_far(typingctx, place, index):
    """`prefetch` into the second cache, for later use."""
    return types.none(place, types.int64), _prefetching(_FAR)


@intrinsic
def prefetch_row(typingctx, array, row):
    """Prefetch the first cache line of a row of the C-ordered array [n, m], into the first cache."""

    def codegen(context, builder, sig, args):
        made = context.make_array(sig.args[0])(context, builder, args[0])
        stride = builder.extract_value(made.strides, 0)
        at = builder.add(builder.ptrtoint(made.data, I64), builder.mul(args[1], stride))
        _prefetch(builder, builder.inttoptr(at, F32.as_pointer()), _NEAR)
        return context.get_dummy_value()

    return types.none(array, types.int64), codegen


@intrinsic
def fetch_add(typingctx, array):
    """Atomically add 1 to the first entry of an int64 array and return the old value: a thread takes its next item."""

    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.atomic_rmw("add", data, ir.Constant(I64, 1), "monotonic")

    return types.int64(array), codegen

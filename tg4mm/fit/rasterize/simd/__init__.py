"""SIMD for numba kernels: sixteen float32 as one value, and what vector instructions do with it.

Why. LLVM's loop vectoriser decides by the shape of a loop, and gives up on gathers, early exits and arrays that may
alias. Here a kernel is written for one vector at a time, so the machine code follows from the source:

    from tg4mm.fit.rasterize.simd.memory import load, store
    from tg4mm.fit.rasterize.simd.vector import LANES, fma, select

    for i in range(0, len(x), LANES):  # len(x) a multiple of 16
        v = load(x, int64(i))
        store(x, int64(i), select(v > zero, fma(v, v, one), zero))

Lanes. A vector is LLVM's <16 x float>, whatever the processor: 16 is one register of AVX-512 and one cache line. LLVM
splits each operation where registers are narrower: in two for AVX2, in four for SSE and NEON. Blending's pixels are the
exception: a block is `PIXELS` lanes, 16 (4 × 4 pixels) with AVX-512 and 8 (4 × 2) elsewhere, since the state of sixteen
pixels does not fit into sixteen narrower registers (`load_pixels`, `broadcast_pixels`; arithmetic, `fma`, `select` and
`store` take either). Besides, only `exp2` and `fma_where` take another way with AVX-512 (`has_avx512`). What a lane
stands for is up to the kernel: a pixel of a block (blending), or a Gaussian (projection, culling); `rows.py` changes
between them.

Masks. A comparison gives a mask, <16 x i1>: `&` joins masks, `select(mask, a, b)` picks by lane, `movemask` makes an
integer of it (lane k is bit k), whose set bits `popcount` counts and `ctz` finds. Every lane is computed: what a mask
leaves out must be selected away, since NaN times 0 is NaN.

Memory. `load` and `store` take 16 numbers from any index, not aligned and not checked; `load_first` and `store_first`
the first n at the end of an array. A place is a contiguous array or an address (`memory.py` says why). `prefetch` early
what lies anywhere in memory.

Rounding. No `fastmath`: with it the last bits would depend on the code a function is inlined into, hence on the
caller and on whether this process compiled it or found it in the cache. `a * b + c` rounds twice; `fma` once, where the
processor can. Sums over lanes go by a fixed tree (`lanes.py`). Results do not depend on the number of threads.

Files: `vector.py` type, operators and masks, `functions.py` exp2, sqrt, log, ceil, floor, `memory.py`, `lanes.py` sums
across lanes and four rows of three (a displacement and its gradient), `rows.py` transposes.
"""

"""benchmarks/limit.py finds the loop over blocks in machine code."""

from __future__ import annotations

from benchmarks.limit import block_loops, composition, inner_loops

# a loop that looks ahead at Gaussians, with a shift and more multiply-adds, then one over a block's pairs
_ASSEMBLY = """
.ahead:
    vpslld $4, %zmm0, %zmm1
    vfmadd213ps %zmm0, %zmm1, %zmm2
    vfmadd213ps %zmm0, %zmm1, %zmm3
    vfmadd213ps %zmm0, %zmm1, %zmm4
    vfmadd213ps %zmm0, %zmm1, %zmm5
    vaddps %zmm0, %zmm1, %zmm6
    vaddps %zmm0, %zmm1, %zmm7
    jle .ahead
.pairs:
    vmovups (%rax), %zmm8
    vpslld $18, %zmm8, %zmm9
    vfmadd213ps (%rbx), %zmm8, %zmm9
    vfmadd213ps %zmm0, %zmm8, %zmm9
    vcmpltps %zmm9, %zmm0, %k1
    jne .pairs
"""


def test_the_loop_over_pairs_is_told_from_the_one_that_looks_ahead() -> None:
    bodies = inner_loops(_ASSEMBLY)
    assert len(bodies) == 2
    ((body, blocks),) = block_loops(bodies)[:1]
    found = composition(body)
    assert blocks == 1
    assert (found.instructions, found.arithmetic, found.multiplications) == (6, 4, 2)
    assert (found.comparisons, found.memory) == (1, 2)

/* Whether a device rounds float32 as common/dual.h and common/phase.h need it: clradar/opencl/self_test.py compares. */
#include "common/phase.h"

static inline dual load(__global const float *in, const uint n) {
    dual v;
    v.hi = LOADW(in);
    v.lo = LOADW(in + n);
    return v;
}

static inline void store(const dual v, __global float *out, const uint n) {
    STOREW(v.hi, out);
    STOREW(v.lo, out + n);
}

/* Item = CLR_WIDTH vectors.
 *
 * n        vectors, a multiple of CLR_WIDTH
 * vectors  float (3, 2, n)  x, y, z as hi, lo
 * found    float (3, 2, n)  out: hi, lo of the product and of the sum of the hi of x and y, and of the length */
__kernel void dual_numbers(const uint n, __global const float *vectors, __global float *found) {
    const uint i = (uint)get_global_id(0) * CLR_WIDTH;
    if (i >= n) return;
    const dual x = load(vectors + i, n), y = load(vectors + 2 * n + i, n);
    const dual z = load(vectors + 4 * n + i, n);
    store(exact_product(x.hi, y.hi), found + i, n);
    store(two_sum(x.hi, y.hi), found + 2 * n + i, n);
    store(dual_length(x, y, z), found + 4 * n + i, n);
}

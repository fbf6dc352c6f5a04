/* Phases relative to the centres of blocks, which all sums over the tree of blocks share. */
#ifndef CLR_FAR
#error "CLR_FAR (1 where float32 is too coarse for the phase over a block) is missing"
#endif

#include "common/phase.h"

/* cos and sin of 2 pi length k, for less than 2^21 cycles: the nearest half is subtracted. Maximal error 2e-7, in
 * half the operations of cos_sin_cycles and shorter chains of them: sums over blocks spend a third of their time
 * here. Minimax polynomials. */
static inline void cos_sin_of(realw length, realw k, realw *cosine, realw *sine) {
    const realw magic = 6291456.0f; /* 1.5 * 2^22: adding it rounds to halves */
    const realw shifted = fused(length, k, magic);
    const realw r = fused(length, k, magic - shifted), r2 = r * r, r4 = r2 * r2;
    const intw sign = AS_INTW(shifted) << 31;
    const realw s0 = fused((realw)(-41.341656f), r2, (realw)(6.283185f));
    realw s = fused((realw)(-76.54978f), r2, (realw)(81.601006f));
    s = fused((realw)(39.536705f), r4, s);
    s = fused(s, r4, s0) * r;
    const realw c0 = fused((realw)(-19.739208f), r2, (realw)(1.0f));
    const realw c1 = fused((realw)(-85.453575f), r2, (realw)(64.93935f));
    realw c = fused((realw)(-24.982239f), r2, (realw)(60.144016f));
    c = fused(c, r4, c1);
    c = fused(c, r4, c0);
    *cosine = AS_REALW(AS_INTW(c) ^ sign);
    *sine = AS_REALW(AS_INTW(s) ^ sign);
}

#if CLR_FAR
/* Over blocks of many wavelengths a float32 has no digits left for the phase: lengths and wavenumbers are
 * kept as hi + lo. */
typedef dual length_type;

/* The coordinate at + rest relative to an antenna's. */
static inline dual from_antenna(realw at, realw rest, realw hi, realw lo) {
    dual d = two_sum(at, -hi);
    d.lo += rest - lo;
    return d;
}

/* |v| - |c| */
static inline dual length_difference(dual vx, dual vy, dual vz, dual cx, dual cy, dual cz) {
    const dual v = dual_length(vx, vy, vz), c = dual_length(cx, cy, cz);
    dual d = two_sum(v.hi, -c.hi);
    d.lo += v.lo - c.lo;
    return two_sum(d.hi, d.lo);
}

static inline void phasor(dual length, float k_hi, float k_lo, realw *cosine, realw *sine) {
    cos_sin_of(cycles(length, make_wavenumber((realw)(k_hi), (realw)(k_lo))), 1.0f, cosine, sine);
}
#else
typedef realw length_type;

/* |v| - |c| for v = c + o, without cancellation; length = |c|. */
static inline realw length_difference(realw vx, realw vy, realw vz, realw cx, realw cy, realw cz,
                                      realw ox, realw oy, realw oz, realw length) {
    const realw sum = square_root(vx * vx + vy * vy + vz * vz) + length;
    const realw product = ox * (vx + cx) + oy * (vy + cy) + oz * (vz + cz);
    return sum > 0.0f ? product / sum : (realw)(0.0f);
}

static inline void phasor(realw length, float k_hi, float k_lo, realw *cosine, realw *sine) {
    cos_sin_of(length, k_hi, cosine, sine);
}
#endif

/* Carrier phase of a path length in float32.
 *
 * A length of 0.5 m is some 130 wavelengths, so a plain float32 length costs about 5e-5 rad. Lengths
 * are therefore kept as hi + lo (common/dual.h), and the phase is counted in cycles and reduced to one
 * cycle before sine and cosine.
 *
 * Polynomials: Cephes sinf/cosf (S. L. Moshier), maximal error 1.1e-7 over a cycle. */
#include "common/dual.h"

/* (ah + al) - (bh + bl), metres. */
static inline dual dual_difference(realw ah, realw al, realw bh, realw bl) {
    dual s = two_sum(ah, -bh);
    s.lo += al - bl;
    return s;
}

/* Length of the vector (x, y, z), metres: sqrt of the sum of squares with one Newton correction. */
static inline dual dual_length(dual x, dual y, dual z) {
    realw xx = x.hi * x.hi, yy = y.hi * y.hi, zz = z.hi * z.hi;
    realw error = square_error(x.hi, xx) + square_error(y.hi, yy) + square_error(z.hi, zz);
    error += 2.0f * (x.hi * x.lo + y.hi * y.lo + z.hi * z.lo);
    dual a = two_sum(xx, yy);
    dual b = two_sum(a.hi, zz);
    error += a.lo + b.lo;
    realw root = sqrt(b.hi);
    dual r;
    r.hi = root;
    /* root = 0 only where both points coincide. */
    const realw square = root * root;
    const realw rest = (b.hi - square) - square_error(root, square);
    r.lo = root > 0.0f ? (rest + error) / (2.0f * root) : (realw)(0.0f);
    return r;
}

/* k = f / c in cycles per metre as hi + lo, with the halves of hi for exact products. */
typedef struct {
    realw hi, lo, high, low;
} wavenumber;

static inline wavenumber make_wavenumber(realw hi, realw lo) {
    wavenumber k;
    k.hi = hi;
    k.lo = lo;
    halves(hi, &k.high, &k.low);
    return k;
}

/* Fraction of a cycle of length * k: half a cycle and the rounding of the product, so within [-1, 1]. Valid
 * up to 2^22 cycles. */
static inline realw cycles(dual length, wavenumber k) {
    const realw magic = 12582912.0f; /* 1.5 * 2^23: adding it rounds to a whole number */
    realw high, low;
    halves(length.hi, &high, &low);
    realw p = length.hi * k.hi;
    realw error = product_error(high, low, k.high, k.low, p);
    error += length.hi * k.lo + length.lo * k.hi;
    return (p - ((p + magic) - magic)) + error;
}

/* cos and sin of 2 pi x, for |x| < 2^19: the nearest quarter is subtracted exactly. */
static inline void cos_sin_cycles(realw x, realw *cosine, realw *sine) {
    const realw magic = 12582912.0f;
    realw shifted = 4.0f * x + magic;
    intw quadrant = AS_INTW(shifted); /* its two lowest bits */
    realw r = (x - 0.25f * (shifted - magic)) * 6.283185307179586f;
    realw r2 = r * r;
    realw s = fused((realw)(-1.9515295891e-4f), r2, (realw)(8.3321608736e-3f));
    s = fused(fused(s, r2, (realw)(-1.6666654611e-1f)), r2 * r, r);
    realw c = fused((realw)(2.443315711809948e-5f), r2, (realw)(-1.388731625493765e-3f));
    c = fused(c, r2, (realw)(4.166664568298827e-2f));
    c = fused(c, r2 * r2, fused((realw)(-0.5f), r2, (realw)(1.0f)));
    intw swapped = (quadrant & 1) != 0;
    realw a = swapped ? s : c;
    realw b = swapped ? c : s;
    *cosine = AS_REALW(AS_INTW(a) ^ (((quadrant + 1) & 2) << 30));
    *sine = AS_REALW(AS_INTW(b) ^ ((quadrant & 2) << 30));
}

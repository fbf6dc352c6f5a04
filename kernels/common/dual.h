/* Double-single arithmetic: a number as an unevaluated sum hi + lo of two float32, with a relative error of
 * about 2^-45 (T. J. Dekker, "A floating-point technique for extending the available precision", Numer. Math. 18
 * (1971) 224).
 *
 * No step needs an fma, and none may be reordered:
 * the programs are built without fast-math, and width.h switches contraction off. */
#include "common/width.h"

typedef struct {
    realw hi;
    realw lo;
} dual;

/* a + b exactly. */
static inline dual two_sum(realw a, realw b) {
    realw s = a + b;
    realw t = s - a;
    dual r;
    r.hi = s;
    r.lo = (a - (s - t)) + (b - t);
    return r;
}

/* Error of the rounded product p = a b, exactly, by splitting both factors in halves of 12 bits: this
 * needs no fma. */
static inline void halves(realw a, realw *high, realw *low) {
    const realw c = 4097.0f * a;
    *high = c - (c - a);
    *low = a - *high;
}

static inline realw product_error(realw a_high, realw a_low, realw b_high, realw b_low, realw p) {
    return ((a_high * b_high - p) + (a_high * b_low + a_low * b_high)) + a_low * b_low;
}

static inline realw square_error(realw a, realw p) {
    realw high, low;
    halves(a, &high, &low);
    return product_error(high, low, high, low, p);
}

static inline dual dual_add(dual a, dual b) {
    dual s = two_sum(a.hi, b.hi);
    return two_sum(s.hi, s.lo + (a.lo + b.lo));
}

static inline dual dual_negative(dual a) {
    a.hi = -a.hi;
    a.lo = -a.lo;
    return a;
}

/* a b, both float32, exactly. */
static inline dual exact_product(realw a, realw b) {
    realw a_high, a_low, b_high, b_low;
    halves(a, &a_high, &a_low);
    halves(b, &b_high, &b_low);
    dual r;
    r.hi = a * b;
    r.lo = product_error(a_high, a_low, b_high, b_low, r.hi);
    return r;
}

static inline dual dual_product(dual a, dual b) {
    dual r = exact_product(a.hi, b.hi);
    r.lo += a.hi * b.lo + a.lo * b.hi;
    return r;
}

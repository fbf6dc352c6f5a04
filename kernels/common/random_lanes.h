/* The random words of common/random.h for CLR_WIDTH counters at a time. */
#include "common/random.h"
#include "common/width.h"

/* Upper and lower half of c times m, by lanes. */
#if CLR_WIDTH == 8
typedef uint8 uintw;
#define LANE_UINT ((uint8)(0, 1, 2, 3, 4, 5, 6, 7))
static inline void product(const uintw c, const uint m, uintw *upper, uintw *lower) {
    const ulong4 even = (as_ulong4(c) & 0xfffffffful) * m, odd = (as_ulong4(c) >> 32) * m;
    *upper = as_uint8((even >> 32) | (odd & 0xffffffff00000000ul));
    *lower = as_uint8((even & 0xfffffffful) | (odd << 32));
}
#else
typedef uint uintw;
#define LANE_UINT (0u)
static inline void product(const uintw c, const uint m, uintw *upper, uintw *lower) {
    *upper = (uint)(((ulong)c * m) >> 32);
    *lower = c * m;
}
#endif
#define UINT_LANE(v, lane) (((const uint *)&(v))[lane])

/* The first two of the words that draw() gives. */
static inline void draw_words(uintw c0, uintw c1, uintw c2, const uint domain, uint seed_low,
                              uint seed_high, uintw *first, uintw *second) {
    uintw c3 = (uintw)(domain);
#pragma unroll
    for (int k = 0; k < 10; ++k) {
        uintw a_upper, a_lower, b_upper, b_lower;
        product(c0, 0xD2511F53u, &a_upper, &a_lower);
        product(c2, 0xCD9E8D57u, &b_upper, &b_lower);
        c0 = b_upper ^ c1 ^ seed_low;
        c1 = b_lower;
        c2 = a_upper ^ c3 ^ seed_high;
        c3 = a_lower;
        seed_low += GOLDEN_RATIO;
        seed_high += 0xBB67AE85u;
    }
    *first = c0;
    *second = c1;
}

/* unit_interval() of each. */
static inline realw unit_intervals(const uintw bits) {
#if CLR_WIDTH == 8
    return convert_float8(as_int8(bits >> 9)) * 0x1p-23f + 0x1p-24f;
#else
    return unit_interval(bits);
#endif
}

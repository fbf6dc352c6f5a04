/* Counter-based random numbers: Philox4x32-10 (J. Salmon et al., "Parallel random numbers: as easy as 1, 2, 3",
 * SC 2011), from the Random123 headers that pyopencl ships. */
#ifdef CLR_CHECKED
/* The memory checker runs unoptimised code and cannot have functions forced inline. */
#define R123_STATIC_INLINE static inline
#define R123_FORCE_INLINE(declaration) declaration
#endif
#include <pyopencl-random123/philox.cl>

#define DOMAIN_SAMPLE 1u
#define DOMAIN_FACE 2u
#define DOMAIN_DIRECTION 3u
#define DOMAIN_WAVE 4u
#define DOMAIN_MICRO 5u

#define GOLDEN_RATIO 0x9E3779B9u /* its fractional part, in 2^-32 */

static inline uint4 draw(uint c0, uint c1, uint c2, uint c3, uint seed_low, uint seed_high) {
    philox4x32_ctr_t counter = {{c0, c1, c2, c3}};
    philox4x32_key_t key = {{seed_low, seed_high}};
    philox4x32_ctr_t r = philox4x32(counter, key);
    return (uint4)(r.v[0], r.v[1], r.v[2], r.v[3]);
}

/* Uniform in (0, 1), never either end: the middle of one of 2^23 cells. With 2^24 of them the middle of
 * the last would round to 1. */
static inline float unit_interval(uint bits) {
    return (float)(bits >> 9) * 0x1p-23f + 0x1p-24f;
}

/* Counter-based random numbers and what is made of them. Needs Philox included before. */
#define DOMAIN_SAMPLE 1u
#define DOMAIN_FACE 2u
#define DOMAIN_DIRECTION 3u

static inline uint4 draw(uint c0, uint c1, uint c2, uint c3, uint seed_low, uint seed_high) {
    philox4x32_ctr_t counter = {{c0, c1, c2, c3}};
    philox4x32_key_t key = {{seed_low, seed_high}};
    philox4x32_ctr_t r = philox4x32(counter, key);
    return (uint4)(r.v[0], r.v[1], r.v[2], r.v[3]);
}

/* Uniform in (0, 1), never either end: the middle of one of 2^24 cells. */
static inline float unit_interval(uint bits) {
    return (float)(bits >> 8) * 0x1p-24f + 0x1p-25f;
}

static inline uint reversed_bits(uint v) {
    v = ((v >> 1) & 0x55555555u) | ((v & 0x55555555u) << 1);
    v = ((v >> 2) & 0x33333333u) | ((v & 0x33333333u) << 2);
    v = ((v >> 4) & 0x0F0F0F0Fu) | ((v & 0x0F0F0F0Fu) << 4);
    v = ((v >> 8) & 0x00FF00FFu) | ((v & 0x00FF00FFu) << 8);
    return (v >> 16) | (v << 16);
}

/* Small helpers on packed float triples. */
static inline float3 load3(__global const float *p) {
    return (float3)(p[0], p[1], p[2]);
}

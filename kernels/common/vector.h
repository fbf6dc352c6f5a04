/* Vector algebra on float3. OpenCL's own functions (dot, cross, vload3, normalize, min, ...) are calls into a
 * library on PoCL, which cost more than the arithmetic. */
static inline float3 load3(__global const float *p) {
    return (float3)(p[0], p[1], p[2]);
}

static inline void store3(const float3 v, __global float *p) {
    p[0] = v.x;
    p[1] = v.y;
    p[2] = v.z;
}

static inline float dot3(const float3 a, const float3 b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline float3 cross3(const float3 a, const float3 b) {
    return (float3)(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

static inline float length3(const float3 v) {
    return sqrt(dot3(v, v));
}

static inline float3 unit(const float3 v) {
    return v / length3(v);
}

static inline float smaller(float a, float b) {
    return a < b ? a : b;
}

static inline float larger(float a, float b) {
    return a > b ? a : b;
}

static inline float absolute(float v) {
    return v < 0.0f ? -v : v;
}

static inline float limited(float v, float low, float high) {
    return smaller(larger(v, low), high);
}

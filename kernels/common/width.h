/* Lanes per work-item, chosen when the program is built: 8 on a CPU, where wide vectors pay, and 1
 * on a GPU, where neighbouring items are the lanes. The same source serves both. */
#ifndef CLR_WIDTH
#error "CLR_WIDTH (lanes per work-item: 1 or 8) is missing"
#endif

/* Products and sums are fused only where the source says fused(): results stay the same whatever the
 * compiler likes elsewhere. */
#pragma OPENCL FP_CONTRACT OFF

/* Vectors that need no more alignment than a float. vload and vstore do the same, but are calls into
 * a library on PoCL, which cost more than the arithmetic around them. Without "aligned" a GPU loads them byte by
 * byte. */
typedef struct __attribute__((packed, aligned(4))) {
    float4 v;
} loose4;
typedef struct __attribute__((packed, aligned(4))) {
    float8 v;
} loose8;
typedef struct __attribute__((packed, aligned(4))) {
    int8 v;
} loose8i;
#define LOAD4(p) (((__global const loose4 *)(p))->v)
#define LOAD8(p) (((__global const loose8 *)(p))->v)
#define LOAD8I(p) (((__global const loose8i *)(p))->v)
#define STORE8(x, p) (((__global loose8 *)(p))->v = (x))

static inline float8 smaller8(float8 a, float8 b) {
    return a < b ? a : b;
}

static inline float8 larger8(float8 a, float8 b) {
    return a > b ? a : b;
}

/* Whether any lane of a comparison holds; any() is a library call too. */
static inline int any8(int8 v) {
    const int4 four = v.lo | v.hi;
    const int2 two = four.lo | four.hi;
    return two.x | two.y;
}

/* Prefetch an address. */
static inline void fetch(__global const float *p) {
#if defined(__x86_64__) || defined(__aarch64__)
    __builtin_prefetch((const void *)(size_t)p);
#endif
}

/* Prefetch 384 bytes: a node without its last row, or a block of triangles. */
static inline void fetch384(__global const float *p) {
#pragma unroll
    for (int line = 0; line < 6; ++line) fetch(p + 16 * line);
}

/* Index of the lowest bit that is set; clz() is a library call, too. */
static inline int lowest(uint bits) {
#if defined(__clang__) && !defined(CLR_CHECKED)
    return __builtin_ctz(bits);
#else
    return 31 - (int)clz(bits & -bits);
#endif
}

static inline int lowest_long(ulong bits) {
#if defined(__clang__) && !defined(CLR_CHECKED)
    return __builtin_ctzl(bits);
#else
    return 63 - (int)clz(bits & -bits);
#endif
}

#if CLR_WIDTH == 8
typedef float8 realw;
typedef int8 intw;
#define LOADW(p) LOAD8(p)
#define STOREW(x, p) STORE8(x, p)
#define ANYW(v) any8(v)
#define FIRSTW(v) ((v).s0)
#define AS_INTW(v) as_int8(v)
#define AS_REALW(v) as_float8(v)
#define TO_INTW(v) convert_int8_rtz(v)
#define TO_REALW(v) convert_float8(v)
#define LANE_INDEX ((realw)(0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f))
#elif CLR_WIDTH == 1
typedef float realw;
typedef int intw;
#define LOADW(p) (*(p))
#define STOREW(x, p) (*(p) = (x))
#define ANYW(v) (v)
#define FIRSTW(v) (v)
#define AS_INTW(v) as_int(v)
#define AS_REALW(v) as_float(v)
#define TO_INTW(v) ((int)(v))
#define TO_REALW(v) ((float)(v))
#define LANE_INDEX (0.0f)
#else
#error "CLR_WIDTH must be 1 or 8"
#endif

/* One lane, by element and not by a swizzle, on which the memory checker crashes. */
#define LANE(v, lane) (((const float *)&(v))[lane])
#define INT_LANE(v, lane) (((const int *)&(v))[lane])

/* Sum of the lanes, in a fixed order. */
static inline float lane_sum(realw v) {
#if CLR_WIDTH == 8
    const float4 four = v.lo + v.hi;
    const float2 two = four.lo + four.hi;
    return two.x + two.y;
#else
    return v;
#endif
}

/* Lane by lane. */
static inline realw choose(intw condition, realw yes, realw no) {
    return condition ? yes : no;
}

static inline realw lesser(realw a, realw b) {
    return a < b ? a : b;
}

static inline realw greater(realw a, realw b) {
    return a > b ? a : b;
}

/* Square roots. sqrt() is a call on PoCL, which costs its caller all registers. */
static inline realw square_root(realw v) {
#if CLR_WIDTH == 8 && defined(__clang__) && !defined(CLR_CHECKED)
    return (realw)(__builtin_sqrtf(v.s0), __builtin_sqrtf(v.s1), __builtin_sqrtf(v.s2),
                   __builtin_sqrtf(v.s3), __builtin_sqrtf(v.s4), __builtin_sqrtf(v.s5),
                   __builtin_sqrtf(v.s6), __builtin_sqrtf(v.s7));
#else
    return sqrt(v);
#endif
}

/* a b + c, in one instruction where the device has one. OpenCL's fma() is a library call on PoCL, ten
 * times slower; nothing here needs its single rounding. */
static inline realw fused(realw a, realw b, realw c) {
#pragma OPENCL FP_CONTRACT ON
    return a * b + c;
}

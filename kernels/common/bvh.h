/* 8-wide bounding volume hierarchy: layout, traversals, and a triangle test whose error is bounded.
 *
 * nodes: float (n_nodes, CLR_NODE_ROWS, CLR_CHILDREN). A node holds the boxes of up to eight children, each padded
 * by the host by the error bound delta below, so that no box test misses what an exact one finds:
 *     [0..7] children, int bits   [8..15] lo x   [16..23] lo y   [24..31] lo z
 *     [32..39] hi x   [40..47] hi y   [48..55] hi z   [56..63] of the first node only
 * A child >= 0 is a node; a child < 0 is a leaf, the block -(child + 1) of triangles. Where there are fewer
 * children, the other boxes are empty (lo > hi).
 *
 * triangles: float (n_blocks, CLR_TRIANGLE_ROWS, CLR_BLOCK), metres. A block holds the up to eight triangles of a
 * leaf in its columns; slot = 8 block + column. Its rows:
 *     [0..2] v0   [3..5] e1 = v1-v0   [6..8] e2 = v2-v0   [9..11] N = e1 x e2 (from float64)
 * In a column that is not used all are 0, and nothing hits it. After the last block: int (n_blocks, 8), the face at
 * each slot.
 *
 * The last row of the first node: word 56, int: n_blocks; 57: 0 if the surface is not closed, else the side,
 * 1 or -1, of most of its faces that is outside; 58 to 63: low and high corner of all boxes.
 *
 * Triangle test (Moeller and Trumbore 1997, written for many directions from one origin o): with
 * T = v0 - o, u |d.N| = +-d.(e2 x T), v |d.N| = +-d.(T x e1), t = T.N / d.N. In float32, with unit
 * roundoff w = 2^-24, the first two are wrong by at most 8 w |T| |e2| and 8 w |T| |e1| (2 w from the
 * roundings of T and e2, 2 w in each component of the cross product, 1.16 times as long as the product
 * of the lengths, and 3 w in the dot product), d by 3 w, and |d.N| by 4 w |N|. Within 12 w |T|_1 |e2|_1,
 * 12 w |T|_1 |e1|_1 and, at the third edge, their sum and 8 w |N|_1, about one hit in a thousand,
 * float32 cannot tell the side of an edge: inside_triangle() does, in doubled precision. There only
 * the roundings of e1 and e2 count, which move an edge by less than 2 w of its length: neighbours
 * overlap by about 1e-10 m instead of leaving a gap. A triangle that is seen edge on within rounding
 * (|d.N| <= 2^-21 |N|_1) is no hit; its neighbours are.
 *
 * delta = 32 w M, with M the largest distance of any vertex or antenna from the origin, bounds all of
 * this and the rounding of points on the surface. Boxes are padded by it, and rays leave a face from
 * 2 delta above it. */
#if !defined(CLR_STACK) || !defined(CLR_CHILDREN) || !defined(CLR_NODE_ROWS)
#error "CLR_STACK (entries of a traversal's stack), CLR_CHILDREN, CLR_NODE_ROWS (of a node) are missing"
#endif
#if !defined(CLR_BLOCK) || !defined(CLR_TRIANGLE_ROWS)
#error "CLR_BLOCK (triangles of a leaf), CLR_TRIANGLE_ROWS (of each) are missing"
#endif
#if CLR_CHILDREN != 8 || CLR_BLOCK != 8
#error "the traversals hold children and triangles in float8"
#endif

#include "common/dual.h"
#include "common/vector.h"

#define NODE_FLOATS (CLR_NODE_ROWS * CLR_CHILDREN)
#define NODE_LOW CLR_CHILDREN
#define NODE_HIGH (4 * CLR_CHILDREN)
#define NODE_BLOCKS (7 * CLR_CHILDREN)
#define NODE_OUTWARD (NODE_BLOCKS + 1)
#define NODE_BOUNDS (NODE_BLOCKS + 2)
#define BLOCK_FLOATS (CLR_TRIANGLE_ROWS * CLR_BLOCK)
#define ROW_E1 (3 * CLR_BLOCK)
#define ROW_E2 (6 * CLR_BLOCK)
#define ROW_N (9 * CLR_BLOCK)

static inline int face_at(__global const float *nodes, __global const float *triangles,
                          const int slot) {
    return as_int(triangles[(size_t)as_int(nodes[NODE_BLOCKS]) * BLOCK_FLOATS + slot]);
}

/* First row of a slot. */
static inline __global const float *slot_of(__global const float *triangles, const int slot) {
    return triangles + (size_t)(slot >> 3) * BLOCK_FLOATS + (slot & 7);
}

/* The vector in three rows of a slot. */
static inline float3 rows3(__global const float *slot) {
    return (float3)(slot[0], slot[CLR_BLOCK], slot[2 * CLR_BLOCK]);
}

/* Prefetch a child that will be visited. */
static inline void fetch_child(__global const float *nodes, __global const float *triangles,
                               const int child) {
    fetch384(child >= 0 ? nodes + (size_t)child * NODE_FLOATS
                        : triangles + (size_t)-(child + 1) * BLOCK_FLOATS);
}

/* Component of the cross product of (ay, az) and (by, bz). */
static inline dual cross_component(realw ay, realw az, realw by, realw bz) {
    return dual_add(exact_product(ay, bz), dual_negative(exact_product(az, by)));
}

static inline dual dual_dot(dual ax, dual ay, dual az, dual bx, dual by, dual bz) {
    return dual_add(dual_add(dual_product(ax, bx), dual_product(ay, by)), dual_product(az, bz));
}

/* Whether the line o + t d passes through the triangle, decided in doubled precision:
 * u |d.N| = +-T.(d x e2), v |d.N| = +-T.(e1 x d). */
static inline intw inside_triangle(__global const float *slot, const float3 o, const realw dx,
                                   const realw dy, const realw dz) {
    const float3 v0 = rows3(slot), e1 = rows3(slot + ROW_E1), e2 = rows3(slot + ROW_E2);
    const float3 n = rows3(slot + ROW_N);
    const dual tx = two_sum((realw)(v0.x), (realw)(-o.x));
    const dual ty = two_sum((realw)(v0.y), (realw)(-o.y));
    const dual tz = two_sum((realw)(v0.z), (realw)(-o.z));
    const dual u =
        dual_dot(tx, ty, tz, cross_component(dy, dz, (realw)(e2.y), (realw)(e2.z)),
                 cross_component(dz, dx, (realw)(e2.z), (realw)(e2.x)),
                 cross_component(dx, dy, (realw)(e2.x), (realw)(e2.y)));
    const dual v =
        dual_dot(tx, ty, tz, cross_component((realw)(e1.y), (realw)(e1.z), dy, dz),
                 cross_component((realw)(e1.z), (realw)(e1.x), dz, dx),
                 cross_component((realw)(e1.x), (realw)(e1.y), dx, dy));
    const dual size = dual_add(dual_add(exact_product(dx, (realw)(n.x)),
                                        exact_product(dy, (realw)(n.y))),
                               exact_product(dz, (realw)(n.z)));
    const dual rest = dual_add(size, dual_negative(dual_add(u, v)));
    const realw sign = size.hi < 0.0f ? (realw)(-1.0f) : (realw)(1.0f);
    const float slack = 0x1p-22f * larger(dot3(e1, e1), dot3(e2, e2));
    return (u.hi * sign >= -slack) & (v.hi * sign >= -slack) & (rest.hi * sign >= -slack);
}

/* 1 / d, kept finite so that no product with it is NaN. */
static inline float safe_inverse(float d) {
    return 1.0f / (d < 1e-18f && d > -1e-18f ? 1e-18f : d);
}

/* Lanes of a comparison as bits. */
static inline uint lanes8(int8 v) {
#ifdef __AVX__
    return (uint)__builtin_ia32_movmskps256(as_float8(v));
#endif
    const int8 weighted = v & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
    const int4 four = weighted.lo | weighted.hi;
    const int2 two = four.lo | four.hi;
    return (uint)(two.x | two.y);
}

static inline float8 absolute8(float8 v) {
    return as_float8(as_int8(v) & 0x7fffffff);
}

static inline float least8(float8 v) {
    const float4 four = v.lo < v.hi ? v.lo : v.hi;
    const float2 two = four.lo < four.hi ? four.lo : four.hi;
    return smaller(two.x, two.y);
}

/* a b + c and a b - c d, contracted to fused operations where the device has them. */
static inline float8 fused8(float8 a, float8 b, float8 c) {
#pragma OPENCL FP_CONTRACT ON
    return a * b + c;
}

static inline float8 cross8(float8 a, float8 b, float8 c, float8 d) {
#pragma OPENCL FP_CONTRACT ON
    return a * b - c * d;
}

/* The triangle tests of a block for one origin, turned so that T.N >= 0. */
typedef struct {
    float8 q2x, q2y, q2z; /* e2 x T */
    float8 q1x, q1y, q1z; /* T x e1 */
    float8 nx, ny, nz;    /* N */
    float8 height;        /* T.N */
    float8 eu, ev, ew;    /* error bounds at the three edges */
    float8 edge_on;       /* and of |d.N| */
} block_tests;

/* `x`, `y`, `z` are three axes, cyclic; `o` is given along them. */
static inline block_tests block_from(__global const float *block, const float3 o, const int x,
                                    const int y, const int z) {
    block_tests s;
    const float8 tx = LOAD8(block + CLR_BLOCK * x) - o.x, ty = LOAD8(block + CLR_BLOCK * y) - o.y,
                 tz = LOAD8(block + CLR_BLOCK * z) - o.z;
    float8 ex = LOAD8(block + ROW_E2 + CLR_BLOCK * x), ey = LOAD8(block + ROW_E2 + CLR_BLOCK * y),
           ez = LOAD8(block + ROW_E2 + CLR_BLOCK * z);
    s.q2x = cross8(ey, tz, ez, ty);
    s.q2y = cross8(ez, tx, ex, tz);
    s.q2z = cross8(ex, ty, ey, tx);
    const float8 e2_size = absolute8(ex) + absolute8(ey) + absolute8(ez);
    ex = LOAD8(block + ROW_E1 + CLR_BLOCK * x);
    ey = LOAD8(block + ROW_E1 + CLR_BLOCK * y);
    ez = LOAD8(block + ROW_E1 + CLR_BLOCK * z);
    s.q1x = cross8(ty, ez, tz, ey);
    s.q1y = cross8(tz, ex, tx, ez);
    s.q1z = cross8(tx, ey, ty, ex);
    s.nx = LOAD8(block + ROW_N + CLR_BLOCK * x);
    s.ny = LOAD8(block + ROW_N + CLR_BLOCK * y);
    s.nz = LOAD8(block + ROW_N + CLR_BLOCK * z);
    s.height = fused8(tx, s.nx, fused8(ty, s.ny, tz * s.nz));
    const int8 sign = as_int8(s.height) & (int)0x80000000;
    s.q2x = as_float8(as_int8(s.q2x) ^ sign);
    s.q2y = as_float8(as_int8(s.q2y) ^ sign);
    s.q2z = as_float8(as_int8(s.q2z) ^ sign);
    s.q1x = as_float8(as_int8(s.q1x) ^ sign);
    s.q1y = as_float8(as_int8(s.q1y) ^ sign);
    s.q1z = as_float8(as_int8(s.q1z) ^ sign);
    s.nx = as_float8(as_int8(s.nx) ^ sign);
    s.ny = as_float8(as_int8(s.ny) ^ sign);
    s.nz = as_float8(as_int8(s.nz) ^ sign);
    s.height = absolute8(s.height);
    const float8 error = 0x1.8p-21f * (absolute8(tx) + absolute8(ty) + absolute8(tz));
    s.eu = error * e2_size;
    s.ev = error * (absolute8(ex) + absolute8(ey) + absolute8(ez));
    s.edge_on = 0x1p-21f * (absolute8(s.nx) + absolute8(s.ny) + absolute8(s.nz));
    s.ew = s.eu + s.ev + s.edge_on;
    return s;
}

typedef struct {
    float distance; /* negative: nothing within reach */
    int triangle;   /* its slot */
    float u, v;
} hit_record;

/* Rows of a node with the slabs by which a ray enters a box; it leaves by the opposite ones. */
typedef struct {
    int x, y, z;
} slabs;

static inline slabs slabs_of(const float3 inverse) {
    return (slabs){inverse.x < 0.0f ? NODE_HIGH : NODE_LOW,
                   (inverse.y < 0.0f ? NODE_HIGH : NODE_LOW) + 8,
                   (inverse.z < 0.0f ? NODE_HIGH : NODE_LOW) + 16};
}

/* Slab test: boxes of a node that a ray meets within reach, as bits, and where it enters them. */
static inline uint boxes_hit(__global const float *node, const slabs in, const float3 inverse,
                             const float3 moved, const float reach, float8 *near) {
    const int both = NODE_LOW + NODE_HIGH;
    *near = larger8(larger8(fused8(LOAD8(node + in.x), (float8)(inverse.x), (float8)(moved.x)),
                            fused8(LOAD8(node + in.y), (float8)(inverse.y), (float8)(moved.y))),
                    larger8(fused8(LOAD8(node + in.z), (float8)(inverse.z), (float8)(moved.z)),
                            (float8)(0.0f)));
    const float8 far = smaller8(
        smaller8(fused8(LOAD8(node + both - in.x), (float8)(inverse.x), (float8)(moved.x)),
                 fused8(LOAD8(node + both + 16 - in.y), (float8)(inverse.y), (float8)(moved.y))),
        smaller8(fused8(LOAD8(node + both + 32 - in.z), (float8)(inverse.z), (float8)(moved.z)),
                 (float8)(reach)));
    return lanes8(*near <= far);
}

/* Dot products of eight vectors with one. */
static inline float8 along8(const float8 x, const float8 y, const float8 z, const float3 d) {
    return fused8(x, (float8)(d.x), fused8(y, (float8)(d.y), z * d.z));
}

/* Closest hit along o + t d, 0 < t < reach; with `any`, the first that is found. Children are visited from near to
 * far. */
static inline hit_record intersect(__global const float *nodes, __global const float *triangles,
                                const float3 o, const float3 d, float reach, const bool any) {
    const float3 inverse = (float3)(safe_inverse(d.x), safe_inverse(d.y), safe_inverse(d.z));
    const float3 moved = -o * inverse;
    const slabs slab = slabs_of(inverse);
    hit_record best;
    best.distance = -1.0f;
    best.triangle = -1;
    best.u = best.v = 0.0f;
    int stack[CLR_STACK];
    float entry[CLR_STACK];
    int top = 0;
    int child = 0;
    for (;;) {
        if (child >= 0) {
            __global const float *node = nodes + (size_t)child * NODE_FLOATS;
            float8 near;
            uint hit = boxes_hit(node, slab, inverse, moved, reach, &near);
            if (hit) {
                __global const int *children = (__global const int *)node;
                const int one = lowest(hit);
                hit &= hit - 1;
                child = children[one];
                if (!hit) continue;
                float at[8];
                ((loose8 *)at)->v = near;
                float d0 = at[one];
                const int base = top;
                do {
                    const int lane = lowest(hit);
                    hit &= hit - 1;
                    int next = children[lane];
                    float dn = at[lane];
                    if (dn < d0) {
                        const int c = child; child = next; next = c;
                        const float q = d0; d0 = dn; dn = q;
                    }
                    int place = top++;
                    for (; place > base && entry[place - 1] < dn; --place) {
                        entry[place] = entry[place - 1];
                        stack[place] = stack[place - 1];
                    }
                    entry[place] = dn;
                    stack[place] = next;
                    fetch_child(nodes, triangles, next);
                } while (hit);
                continue;
            }
        } else {
            const int block = -(child + 1);
            __global const float *rows = triangles + (size_t)block * BLOCK_FLOATS;
            const block_tests s = block_from(rows, o, 0, 1, 2);
            const float8 size = along8(s.nx, s.ny, s.nz, d);
            const float8 u = along8(s.q2x, s.q2y, s.q2z, d), v = along8(s.q1x, s.q1y, s.q1z, d);
            int8 hit = (u >= -s.eu) & (v >= -s.ev) & (u + v <= size + s.ew) & (size > s.edge_on) &
                       (s.height > 0.0f) & (s.height < reach * size);
            if (any8(hit)) {
                uint unsure = lanes8(hit & ((u <= s.eu) | (v <= s.ev) | (u + v >= size - s.ew)));
                int no[8] = {0, 0, 0, 0, 0, 0, 0, 0};
                for (; unsure; unsure &= unsure - 1) {
                    const int lane = lowest(unsure);
                    no[lane] = !FIRSTW(inside_triangle(rows + lane, o, (realw)(d.x), (realw)(d.y),
                                                       (realw)(d.z)));
                }
                hit &= ((loose8i *)no)->v == 0;
                const float8 at = hit ? s.height / size : (float8)(FLT_MAX);
                const float nearest = least8(at);
                /* Of two at the same distance the first stays. */
                if (nearest < reach || (best.triangle < 0 && any8(hit))) {
                    const int lane = lowest(lanes8(hit & (at == nearest)));
                    float weights[24];
                    ((loose8 *)weights)->v = u;
                    ((loose8 *)(weights + 8))->v = v;
                    ((loose8 *)(weights + 16))->v = size;
                    reach = nearest;
                    best.distance = nearest;
                    best.triangle = block * CLR_BLOCK + lane;
                    best.u = weights[lane] / weights[16 + lane];
                    best.v = weights[8 + lane] / weights[16 + lane];
                    if (any) return best;
                }
            }
        }
        do {
            if (top == 0) return best;
            child = stack[--top];
        } while (entry[top] > reach);
    }
}

/* Whether a point is inside a closed surface, by the parity of the faces that one ray to infinity crosses. Then every
 * ray from it to a point outside of all boxes is blocked. False where an edge is too close to the ray, or a face to
 * the point, to count in float32. */
static inline bool inside_closed(__global const float *nodes, __global const float *triangles,
                                 const float3 o, const float3 d, const float delta) {
    const float3 inverse = (float3)(safe_inverse(d.x), safe_inverse(d.y), safe_inverse(d.z));
    const float3 moved = -o * inverse;
    const slabs slab = slabs_of(inverse);
    int stack[CLR_STACK];
    int top = 0, child = 0;
    uint count = 0;
    for (;;) {
        if (child >= 0) {
            __global const float *node = nodes + (size_t)child * NODE_FLOATS;
            float8 near;
            uint hit = boxes_hit(node, slab, inverse, moved, FLT_MAX, &near);
            for (; hit; hit &= hit - 1) {
                stack[top] = ((__global const int *)node)[lowest(hit)];
                fetch_child(nodes, triangles, stack[top++]);
            }
        } else {
            const block_tests s =
                block_from(triangles + (size_t)-(child + 1) * BLOCK_FLOATS, o, 0, 1, 2);
            const float8 size = along8(s.nx, s.ny, s.nz, d);
            const float8 u = along8(s.q2x, s.q2y, s.q2z, d), v = along8(s.q1x, s.q1y, s.q1z, d);
            const int8 maybe = (u >= -s.eu) & (v >= -s.ev) & (u + v <= size + s.ew) &
                               (size >= -s.edge_on) & (s.edge_on > 0.0f);
            const int8 surely = maybe & (u > s.eu) & (v > s.ev) & (u + v < size - s.ew) &
                                (size > s.edge_on) & (s.height > delta * 0x1p21f * s.edge_on);
            if (any8(maybe & ~surely)) return false;
            count += popcount(lanes8(surely));
        }
        if (top == 0) return count & 1;
        child = stack[--top];
    }
}

/* 8-wide bounding volume hierarchy: layout, and a triangle test whose error is bounded. The traversals are in
 * common/traverse_wide.h for a CPU and common/traverse_narrow.h for a GPU; both find the same hits to the bit.
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
#ifndef CLR_WIDE
#error "CLR_WIDE (1: eight children or triangles at a time, 0: one ray with few registers) is missing"
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

/* Component of the cross product of (ay, az) and (by, bz). */
static inline dual cross_component(realw ay, realw az, realw by, realw bz) {
    return dual_add(exact_product(ay, bz), dual_negative(exact_product(az, by)));
}

static inline dual dual_dot(dual ax, dual ay, dual az, dual bx, dual by, dual bz) {
    return dual_add(dual_add(dual_product(ax, bx), dual_product(ay, by)), dual_product(az, bz));
}

/* Whether the line o + t d passes through the triangle, decided in doubled precision:
 * u |d.N| = +-T.(d x e2), v |d.N| = +-T.(e1 x d). One after the other, since a GPU has registers for one. */
static inline intw inside_triangle(__global const float *slot, const float3 o, const realw dx,
                                   const realw dy, const realw dz) {
    const float3 v0 = rows3(slot), e1 = rows3(slot + ROW_E1), e2 = rows3(slot + ROW_E2);
    const float3 n = rows3(slot + ROW_N);
    const dual tx = two_sum((realw)(v0.x), (realw)(-o.x));
    const dual ty = two_sum((realw)(v0.y), (realw)(-o.y));
    const dual tz = two_sum((realw)(v0.z), (realw)(-o.z));
    const dual size = dual_add(dual_add(exact_product(dx, (realw)(n.x)),
                                        exact_product(dy, (realw)(n.y))),
                               exact_product(dz, (realw)(n.z)));
    const realw sign = size.hi < 0.0f ? (realw)(-1.0f) : (realw)(1.0f);
    const float slack = 0x1p-22f * larger(dot3(e1, e1), dot3(e2, e2));
    const dual u =
        dual_dot(tx, ty, tz, cross_component(dy, dz, (realw)(e2.y), (realw)(e2.z)),
                 cross_component(dz, dx, (realw)(e2.z), (realw)(e2.x)),
                 cross_component(dx, dy, (realw)(e2.x), (realw)(e2.y)));
    intw inside = u.hi * sign >= -slack;
    if (!ANYW(inside)) return inside;
    const dual v =
        dual_dot(tx, ty, tz, cross_component((realw)(e1.y), (realw)(e1.z), dy, dz),
                 cross_component((realw)(e1.z), (realw)(e1.x), dz, dx),
                 cross_component((realw)(e1.x), (realw)(e1.y), dx, dy));
    inside &= v.hi * sign >= -slack;
    if (!ANYW(inside)) return inside;
    const dual rest = dual_add(size, dual_negative(dual_add(u, v)));
    return inside & (rest.hi * sign >= -slack);
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

static inline float least8(float8 v) {
    const float4 four = v.lo < v.hi ? v.lo : v.hi;
    const float2 two = four.lo < four.hi ? four.lo : four.hi;
    return smaller(two.x, two.y);
}

/* Triangles that are tested at a time: on a CPU a block; on a GPU, whose lanes are other rays, one. */
#if CLR_WIDE
#define PACK 8
typedef float8 packf;
typedef int8 packi;
typedef loose8 loose_packf;
typedef loose8i loose_packi;
#define LOAD_PACK(p) LOAD8(p)
#define AS_PACKF(v) as_float8(v)
#define AS_PACKI(v) as_int8(v)
#define PACK_LANES(v) lanes8(v)
#define PACK_LEAST(v) least8(v)
#else
#define PACK 1
typedef float packf;
typedef int packi;
typedef struct {
    packf v;
} loose_packf;
typedef struct {
    packi v;
} loose_packi;
#define LOAD_PACK(p) (*(p))
#define AS_PACKF(v) as_float(v)
#define AS_PACKI(v) as_int(v)
#define PACK_LANES(v) ((uint)(v))
#define PACK_LEAST(v) (v)
#endif

static inline packf absolute_pack(packf v) {
    return AS_PACKF(AS_PACKI(v) & 0x7fffffff);
}

/* a b + c and a b - c d, contracted to fused operations where the device has them. */
static inline packf fused_pack(packf a, packf b, packf c) {
#pragma OPENCL FP_CONTRACT ON
    return a * b + c;
}

static inline packf cross_pack(packf a, packf b, packf c, packf d) {
#pragma OPENCL FP_CONTRACT ON
    return a * b - c * d;
}

/* Dot products of vectors with one. */
static inline packf along_pack(const packf x, const packf y, const packf z, const float3 d) {
    return fused_pack(x, (packf)(d.x), fused_pack(y, (packf)(d.y), z * d.z));
}

/* The tests of PACK triangles of a block for one origin, turned so that T.N >= 0. */
typedef struct {
    packf q2x, q2y, q2z; /* e2 x T */
    packf q1x, q1y, q1z; /* T x e1 */
    packf nx, ny, nz;    /* N */
    packf height;        /* T.N */
    packf eu, ev, ew;    /* error bounds at the three edges */
    packf edge_on;       /* and of |d.N| */
} block_tests;

/* `x`, `y`, `z` are three axes, cyclic; `o` is given along them. */
static inline block_tests block_from(__global const float *block, const float3 o, const int x,
                                    const int y, const int z) {
    block_tests s;
    const packf tx = LOAD_PACK(block + CLR_BLOCK * x) - o.x, ty = LOAD_PACK(block + CLR_BLOCK * y) - o.y,
                 tz = LOAD_PACK(block + CLR_BLOCK * z) - o.z;
    packf ex = LOAD_PACK(block + ROW_E2 + CLR_BLOCK * x), ey = LOAD_PACK(block + ROW_E2 + CLR_BLOCK * y),
           ez = LOAD_PACK(block + ROW_E2 + CLR_BLOCK * z);
    s.q2x = cross_pack(ey, tz, ez, ty);
    s.q2y = cross_pack(ez, tx, ex, tz);
    s.q2z = cross_pack(ex, ty, ey, tx);
    const packf e2_size = absolute_pack(ex) + absolute_pack(ey) + absolute_pack(ez);
    ex = LOAD_PACK(block + ROW_E1 + CLR_BLOCK * x);
    ey = LOAD_PACK(block + ROW_E1 + CLR_BLOCK * y);
    ez = LOAD_PACK(block + ROW_E1 + CLR_BLOCK * z);
    s.q1x = cross_pack(ty, ez, tz, ey);
    s.q1y = cross_pack(tz, ex, tx, ez);
    s.q1z = cross_pack(tx, ey, ty, ex);
    s.nx = LOAD_PACK(block + ROW_N + CLR_BLOCK * x);
    s.ny = LOAD_PACK(block + ROW_N + CLR_BLOCK * y);
    s.nz = LOAD_PACK(block + ROW_N + CLR_BLOCK * z);
    s.height = fused_pack(tx, s.nx, fused_pack(ty, s.ny, tz * s.nz));
    const packi sign = AS_PACKI(s.height) & (int)0x80000000;
    s.q2x = AS_PACKF(AS_PACKI(s.q2x) ^ sign);
    s.q2y = AS_PACKF(AS_PACKI(s.q2y) ^ sign);
    s.q2z = AS_PACKF(AS_PACKI(s.q2z) ^ sign);
    s.q1x = AS_PACKF(AS_PACKI(s.q1x) ^ sign);
    s.q1y = AS_PACKF(AS_PACKI(s.q1y) ^ sign);
    s.q1z = AS_PACKF(AS_PACKI(s.q1z) ^ sign);
    s.nx = AS_PACKF(AS_PACKI(s.nx) ^ sign);
    s.ny = AS_PACKF(AS_PACKI(s.ny) ^ sign);
    s.nz = AS_PACKF(AS_PACKI(s.nz) ^ sign);
    s.height = absolute_pack(s.height);
    const packf error = 0x1.8p-21f * (absolute_pack(tx) + absolute_pack(ty) + absolute_pack(tz));
    s.eu = error * e2_size;
    s.ev = error * (absolute_pack(ex) + absolute_pack(ey) + absolute_pack(ez));
    s.edge_on = 0x1p-21f * (absolute_pack(s.nx) + absolute_pack(s.ny) + absolute_pack(s.nz));
    s.ew = s.eu + s.ev + s.edge_on;
    return s;
}

typedef struct {
    float distance; /* FLT_MAX: nothing within reach */
    int triangle;   /* its slot; -1: nothing */
    float u, v;
} hit_record;

/* Hit the triangles of a block at 0 < t < limit if they are nearer than `best`; of two at the same distance the first
 * in the tree counts, in whatever order they are met. */
static inline void hit_block(__global const float *triangles, const int block, const float3 o,
                             const float3 d, const float limit, hit_record *best) {
#pragma unroll 1
    for (int column = 0; column < CLR_BLOCK; column += PACK) {
        __global const float *rows = triangles + (size_t)block * BLOCK_FLOATS + column;
        const block_tests s = block_from(rows, o, 0, 1, 2);
        const packf size = along_pack(s.nx, s.ny, s.nz, d);
        const packf u = along_pack(s.q2x, s.q2y, s.q2z, d), v = along_pack(s.q1x, s.q1y, s.q1z, d);
        /* A little beyond the best, since the quotient is rounded. */
        const float reach = best->distance * (1.0f + 0x1p-22f);
        packi hit = (u >= -s.eu) & (v >= -s.ev) & (u + v <= size + s.ew) & (size > s.edge_on) &
                    (s.height > 0.0f) & (s.height < limit * size) & (s.height <= reach * size);
        if (!PACK_LANES(hit)) continue;
        uint unsure = PACK_LANES(hit & ((u <= s.eu) | (v <= s.ev) | (u + v >= size - s.ew)));
        int no[PACK] = {0};
        for (; unsure; unsure &= unsure - 1) {
            const int lane = lowest(unsure);
            no[lane] = !FIRSTW(inside_triangle(rows + lane, o, (realw)(d.x), (realw)(d.y),
                                               (realw)(d.z)));
        }
        hit &= ((loose_packi *)no)->v == 0;
        const packf at = hit ? s.height / size : (packf)(FLT_MAX);
        const float nearest = PACK_LEAST(at);
        const uint found = PACK_LANES(hit & (at == nearest));
        if (!found) continue;
        const int lane = lowest(found), slot = block * CLR_BLOCK + column + lane;
        if (nearest < best->distance || (nearest == best->distance && (uint)slot < (uint)best->triangle)) {
            float weights[3 * PACK];
            ((loose_packf *)weights)->v = u;
            ((loose_packf *)(weights + PACK))->v = v;
            ((loose_packf *)(weights + 2 * PACK))->v = size;
            best->distance = nearest;
            best->triangle = slot;
            best->u = weights[lane] / weights[2 * PACK + lane];
            best->v = weights[PACK + lane] / weights[2 * PACK + lane];
        }
    }
}

/* Rows of a node with the slabs by which a ray enters a box; it leaves by the opposite ones. */
typedef struct {
    int x, y, z;
} slabs;

static inline slabs slabs_of(const float3 inverse) {
    return (slabs){inverse.x < 0.0f ? NODE_HIGH : NODE_LOW,
                   (inverse.y < 0.0f ? NODE_HIGH : NODE_LOW) + 8,
                   (inverse.z < 0.0f ? NODE_HIGH : NODE_LOW) + 16};
}

#if CLR_WIDE
#include "common/traverse_wide.h"
#else
#include "common/traverse_narrow.h"
#endif

/* What both ways through the tree of blocks share (backproject_fast.cl, forward_fast.cl): phases relative to
 * the centres of blocks, weighted sums over rows, and where the voxels or points of the smallest blocks are.
 *
 * G  float (n_blocks, n_m, n_rows, 2, n_columns): real and imaginary parts of a row side by side; rows
 *    are padded to a multiple of CLR_WIDTH and of CLR_TILE columns. */
#ifndef CLR_ROWS
#error "CLR_ROWS (most rows of a block: they are held in private memory) is missing"
#endif
#ifndef CLR_LEAF
#error "CLR_LEAF (most rows or columns of a smallest block, held in private memory) is missing"
#endif
#ifndef CLR_FAR
#error "CLR_FAR (1 where float32 is too coarse for the phase over a block) is missing"
#endif
#ifndef CLR_TILE
#error "CLR_TILE (weighted sums per pass over the rows) is missing"
#elif CLR_TILE != 4
#error "CLR_TILE must be 4: transposed sums are stored as float4"
#endif
#ifndef CLR_KEPT
#error "CLR_KEPT (most skeleton voxels of a row, held in private memory; 0 where all voxels are summed) is missing"
#endif
#ifndef CLR_POINTS
#error "CLR_POINTS (1 for points, 0 for the voxels of a grid) is missing"
#endif

#include "common/phase.h"

/* cos and sin of 2 pi length k, for less than 2^21 cycles: the nearest half is subtracted. Maximal error 2e-7, in
 * half the operations of cos_sin_cycles and shorter chains of them: sums over blocks spend a third of their time
 * here. Minimax polynomials. */
static inline void cos_sin_of(realw length, realw k, realw *cosine, realw *sine) {
    const realw magic = 6291456.0f; /* 1.5 * 2^22: adding it rounds to halves */
    const realw shifted = fused(length, k, magic);
    const realw r = fused(length, k, magic - shifted), r2 = r * r, r4 = r2 * r2;
    const intw sign = AS_INTW(shifted) << 31;
    const realw s0 = fused((realw)(-41.341656f), r2, (realw)(6.283185f));
    realw s = fused((realw)(-76.54978f), r2, (realw)(81.601006f));
    s = fused((realw)(39.536705f), r4, s);
    s = fused(s, r4, s0) * r;
    const realw c0 = fused((realw)(-19.739208f), r2, (realw)(1.0f));
    const realw c1 = fused((realw)(-85.453575f), r2, (realw)(64.93935f));
    realw c = fused((realw)(-24.982239f), r2, (realw)(60.144016f));
    c = fused(c, r4, c1);
    c = fused(c, r4, c0);
    *cosine = AS_REALW(AS_INTW(c) ^ sign);
    *sine = AS_REALW(AS_INTW(s) ^ sign);
}

#if CLR_FAR
/* Over blocks of many wavelengths a float32 has no digits left for the phase: lengths and wavenumbers are
 * kept as hi + lo. */
typedef dual length_type;

/* The coordinate at + rest relative to an antenna's. */
static inline dual from_antenna(realw at, realw rest, realw hi, realw lo) {
    dual d = two_sum(at, -hi);
    d.lo += rest - lo;
    return d;
}

/* |v| - |c| */
static inline dual length_difference(dual vx, dual vy, dual vz, dual cx, dual cy, dual cz) {
    const dual v = dual_length(vx, vy, vz), c = dual_length(cx, cy, cz);
    dual d = two_sum(v.hi, -c.hi);
    d.lo += v.lo - c.lo;
    return two_sum(d.hi, d.lo);
}

static inline void phasor(dual length, float k_hi, float k_lo, realw *cosine, realw *sine) {
    cos_sin_of(cycles(length, make_wavenumber((realw)(k_hi), (realw)(k_lo))), 1.0f, cosine, sine);
}
#else
typedef realw length_type;

/* |v| - |c| for v = c + o, without cancellation; length = |c|. */
static inline realw length_difference(realw vx, realw vy, realw vz, realw cx, realw cy, realw cz,
                                      realw ox, realw oy, realw oz, realw length) {
    const realw sum = square_root(vx * vx + vy * vy + vz * vz) + length;
    const realw product = ox * (vx + cx) + oy * (vy + cy) + oz * (vz + cz);
    return sum > 0.0f ? product / sum : (realw)(0.0f);
}

static inline void phasor(realw length, float k_hi, float k_lo, realw *cosine, realw *sine) {
    cos_sin_of(length, k_hi, cosine, sine);
}
#endif

/* Rows of one block and frequency, CLR_WIDTH columns of them, times their phasors where there are any. A CPU holds
 * them in private memory for all sums; a GPU, where that would be far away, reads them again. */
typedef struct {
    __global const float *g, *phasors;
    uint n_columns, n_phasors;
#if CLR_WIDTH == 8
    realw re[CLR_ROWS], im[CLR_ROWS];
#endif
} row_set;

static inline void read_row(const row_set *rows, const uint i, realw *re, realw *im) {
    const realw a = LOADW(rows->g + (size_t)2 * i * rows->n_columns);
    const realw b = LOADW(rows->g + (size_t)(2 * i + 1) * rows->n_columns);
    *re = a;
    *im = b;
    if (!rows->phasors) return;
    const realw cosine = rows->phasors[i], sine = rows->phasors[rows->n_phasors + i];
    *re = fused(a, cosine, -(b * sine));
    *im = fused(a, sine, b * cosine);
}

/* To be called before sum_rows. */
static inline void hold_rows(row_set *rows, const uint n_rows) {
#if CLR_WIDTH == 8
    for (uint i = 0; i < n_rows; ++i) read_row(rows, i, rows->re + i, rows->im + i);
#endif
}

/* Sums over the rows, weighted with CLR_TILE neighbouring columns of the weights. */
typedef struct {
    realw re[CLR_TILE], im[CLR_TILE];
} weighted_sums;

static inline weighted_sums sum_rows(const uint n_rows, const row_set *rows,
                                     __global const float *weights, const uint n_weights) {
    weighted_sums sum;
#pragma unroll
    for (uint t = 0; t < CLR_TILE; ++t) sum.re[t] = sum.im[t] = 0.0f;
    for (uint i = 0; i < n_rows; ++i) {
        __global const float *w = weights + (size_t)i * n_weights;
#if CLR_WIDTH == 8
        const realw a = rows->re[i], b = rows->im[i];
#else
        realw a, b;
        read_row(rows, i, &a, &b);
#endif
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) {
            sum.re[t] = fused(a, (realw)(w[t]), sum.re[t]);
            sum.im[t] = fused(b, (realw)(w[t]), sum.im[t]);
        }
    }
    return sum;
}

/* Columns of weighted sums become rows: lane l of sum t goes to number t of row l.
 *
 * out  float (n_rows, 2, n_out)                CLR_TILE numbers from here on, in each of the first n_rows rows */
static inline void store_transposed(const weighted_sums sum, const uint n_rows, const uint n_out,
                                    __global float *out) {
#define FOUR(part, lane) (float4)(part[0] lane, part[1] lane, part[2] lane, part[3] lane)
#define STORE_LANE(number, lane)                                                                   \
    if (number < n_rows) {                                                                         \
        __global float *at = out + (size_t)2 * number * n_out;                                     \
        ((__global loose4 *)at)->v = FOUR(sum.re, lane);                                           \
        ((__global loose4 *)(at + n_out))->v = FOUR(sum.im, lane);                                 \
    }
#if CLR_WIDTH == 8
    STORE_LANE(0, .s0)
    STORE_LANE(1, .s1)
    STORE_LANE(2, .s2)
    STORE_LANE(3, .s3)
    STORE_LANE(4, .s4)
    STORE_LANE(5, .s5)
    STORE_LANE(6, .s6)
    STORE_LANE(7, .s7)
#else
    STORE_LANE(0, )
#endif
}

/* CLR_WIDTH voxels relative to the centre of a block, metres; the rests of the float32 coordinates with
 * CLR_FAR only. */
typedef struct {
    realw x, y, z;
#if CLR_FAR
    realw x_rest, y_rest, z_rest;
#endif
} offsets;

/* |v - a| - |c - a| per lane, for v = c + o and an antenna float (6): x, y, z as hi, then as lo. */
static inline length_type length_from_centre(const offsets o, __global const float *c,
                                             __global const float *a) {
#if CLR_FAR
    const realw none = 0.0f;
    const dual cx = from_antenna(c[0], none, a[0], a[3]);
    const dual cy = from_antenna(c[1], none, a[1], a[4]);
    const dual cz = from_antenna(c[2], none, a[2], a[5]);
    const dual ox = {o.x, o.x_rest}, oy = {o.y, o.y_rest}, oz = {o.z, o.z_rest};
    return length_difference(dual_add(cx, ox), dual_add(cy, oy), dual_add(cz, oz), cx, cy, cz);
#else
    const float cx = c[0] - a[0], cy = c[1] - a[1], cz = c[2] - a[2];
    return length_difference(o.x + cx, o.y + cy, o.z + cz, cx, cy, cz, o.x, o.y, o.z,
                             square_root((realw)(cx * cx + cy * cy + cz * cz)));
#endif
}

/* Number of voxels or points of a block. */
static inline uint leaf_size(const uint n_voxels, __global const int *first) {
#if CLR_POINTS
    return (uint)(first[1] - first[0]);
#else
    return n_voxels;
#endif
}

/* CLR_WIDTH voxels of a block, relative to its centre.
 *
 * offset   float (6 or 3, n_offsets)           x, y, z as hi, then with CLR_FAR as lo, metres: of the voxels of
 *                                              any block from its exact centre, or of every point from the float32
 *                                              centre of its block; CLR_WIDTH numbers may be read from any on
 * rest     float (3)                           exact centre minus its float32, metres; 0 for points
 * first    int (3)                             x, y, z index of the block's first voxel; or the block's first
 *                                              point, the one after its last, 0 */
static inline offsets load_offsets(const uint n_offsets, const uint voxel,
                                   __global const float *offset, __global const float *rest,
                                   __global const int *first) {
#if CLR_POINTS
    __global const float *at = offset + first[0] + voxel;
#else
    __global const float *at = offset + voxel;
#endif
    offsets o;
    o.x = LOADW(at) + rest[0];
    o.y = LOADW(at + n_offsets) + rest[1];
    o.z = LOADW(at + 2 * (size_t)n_offsets) + rest[2];
#if CLR_FAR
    o.x_rest = LOADW(at + 3 * (size_t)n_offsets) + ((LOADW(at) - o.x) + rest[0]);
    o.y_rest = LOADW(at + 4 * (size_t)n_offsets) + ((LOADW(at + n_offsets) - o.y) + rest[1]);
    o.z_rest =
        LOADW(at + 5 * (size_t)n_offsets) + ((LOADW(at + 2 * (size_t)n_offsets) - o.z) + rest[2]);
#endif
    return o;
}

/* Index into the volume, or into the points, of a voxel of a block; -1 where there is none.
 *
 * place    int (n_voxels, 3)                   x, y, z index of a voxel in its block; not read for points */
static inline long leaf_index(const uint n_x, const uint n_y, const uint n_z, const uint voxel,
                              __global const int *first, __global const int *place) {
#if CLR_POINTS
    const long point = (long)first[0] + voxel;
    return point < first[1] ? point : -1;
#else
    __global const int *s = place + 3 * voxel;
    const uint x = (uint)(first[0] + s[0]), y = (uint)(first[1] + s[1]);
    const uint z = (uint)(first[2] + s[2]);
    return x < n_x && y < n_y && z < n_z ? ((long)z * n_y + y) * n_x + x : -1;
#endif
}

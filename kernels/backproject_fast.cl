/* Fast factorised back-projection (Ulander, Hellsten, Stenstroem, IEEE Trans. AES 39 (2003) 760) over a
 * tree of blocks of voxels. With the samples referred to the centre c of a block, G, the sum
 *     V(v) = sum_{t, r, m} G[m, t, r] exp(+j 2 pi k_m (|v - t| - |c - t| + |v - r| - |c - r|))
 * varies slowly over antennas and frequencies, and a skeleton of few of either approximates it: the terms
 * of the rest are added to those of the skeleton with the weights of an interpolative decomposition
 * (clradar.phasors.interpolative.py). From a block to the smaller blocks in it, G is referred to their
 * centres and reduced to fewer rows, columns and frequencies; in the smallest blocks V is summed directly.
 * Rows and columns (transmitters and receivers, or the other way round) are transposed from level to
 * level, so that the sum over rows is always the first one.
 *
 * G  float (n_blocks, n_m, n_rows, 2, n_columns): real and imaginary parts of a row side by side; rows
 *    are padded with zeros to a multiple of CLR_WIDTH and of CLR_TILE columns. */
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

#include "common/phase.h"

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
    cos_sin_cycles(cycles(length, make_wavenumber((realw)(k_hi), (realw)(k_lo))), cosine, sine);
}
#else
typedef realw length_type;

/* x reduced to at most half a cycle, for |x| < 2^22. */
static inline realw wrapped(realw x) {
    const realw magic = 12582912.0f;
    return x - ((x + magic) - magic);
}

/* |v| - |c| for v = c + o, without cancellation. */
static inline realw length_difference(realw vx, realw vy, realw vz, realw cx, realw cy, realw cz,
                                      realw ox, realw oy, realw oz) {
    const realw sum = sqrt(vx * vx + vy * vy + vz * vz) + sqrt(cx * cx + cy * cy + cz * cz);
    const realw product = ox * (vx + cx) + oy * (vy + cy) + oz * (vz + cz);
    return sum > 0.0f ? product / sum : (realw)(0.0f);
}

static inline void phasor(realw length, float k_hi, float k_lo, realw *cosine, realw *sine) {
    cos_sin_cycles(wrapped(length * k_hi), cosine, sine);
}
#endif

/* The phasors that refer each antenna's samples from a block's centre to that of a block in it. Item =
 * CLR_WIDTH antennas of one block.
 *
 * antennas  float (6, n_columns)               x, y, z as hi, then as lo, metres; n_columns a multiple of
 *                                              CLR_WIDTH
 * k         float (2, n_m)                     cycles per metre as hi, then lo
 * centres   float (n_blocks, 3)                metres
 * parents   float (n_parents, 3)
 * parent    int (n_blocks)
 * phasors   float (n_blocks, n_m, 2, n_columns)  out: cosine, sine */
__kernel void block_phasors(const uint n_columns, const uint n_blocks, const uint n_m,
                          __global const float *antennas, __global const float *k,
                          __global const float *centres, __global const float *parents,
                          __global const int *parent, __global float *phasors) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, block = (uint)get_global_id(1);
    if (column >= n_columns || block >= n_blocks) return;
    const realw ax = LOADW(antennas + column), ay = LOADW(antennas + n_columns + column);
    const realw az = LOADW(antennas + 2 * n_columns + column);
    __global const float *c = centres + 3 * block, *p = parents + 3 * parent[block];
#if CLR_FAR
    const realw bx = LOADW(antennas + 3 * n_columns + column);
    const realw by = LOADW(antennas + 4 * n_columns + column);
    const realw bz = LOADW(antennas + 5 * n_columns + column), none = 0.0f;
    const dual length = length_difference(
        from_antenna(c[0], none, ax, bx), from_antenna(c[1], none, ay, by),
        from_antenna(c[2], none, az, bz), from_antenna(p[0], none, ax, bx),
        from_antenna(p[1], none, ay, by), from_antenna(p[2], none, az, bz));
#else
    const realw length = length_difference(c[0] - ax, c[1] - ay, c[2] - az, p[0] - ax, p[1] - ay,
                                           p[2] - az, c[0] - p[0], c[1] - p[1], c[2] - p[2]);
#endif
    __global float *out = phasors + (size_t)2 * block * n_m * n_columns + column;
    for (uint m = 0; m < n_m; ++m) {
        realw cosine, sine;
        phasor(length, k[m], k[n_m + m], &cosine, &sine);
        STOREW(cosine, out);
        STOREW(sine, out + n_columns);
        out += 2 * n_columns;
    }
}

/* Rows of one block and frequency, CLR_WIDTH columns of them, times their phasors. */
static inline void rotated_rows(const uint n_rows, const uint n_columns, __global const float *g,
                                const uint n_phasors, __global const float *phasors, realw *re,
                                realw *im) {
    for (uint i = 0; i < n_rows; ++i) {
        const realw a = LOADW(g + (size_t)2 * i * n_columns);
        const realw b = LOADW(g + (size_t)(2 * i + 1) * n_columns);
        const realw cosine = phasors[i], sine = phasors[n_phasors + i];
        re[i] = fused(a, cosine, -(b * sine));
        im[i] = fused(a, sine, b * cosine);
    }
}

/* Sums over the rows, weighted with CLR_TILE neighbouring columns of the weights. */
typedef struct {
    realw re[CLR_TILE], im[CLR_TILE];
} weighted_sums;

static inline weighted_sums sum_rows(const uint n_rows, const realw *re, const realw *im,
                                     __global const float *weights, const uint n_weights) {
    weighted_sums sum;
    for (uint t = 0; t < CLR_TILE; ++t) sum.re[t] = sum.im[t] = 0.0f;
    for (uint i = 0; i < n_rows; ++i) {
        __global const float *w = weights + (size_t)i * n_weights;
        const realw a = re[i], b = im[i];
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) {
            sum.re[t] = fused(a, (realw)(w[t]), sum.re[t]);
            sum.im[t] = fused(b, (realw)(w[t]), sum.im[t]);
        }
    }
    return sum;
}

/* Multiply the rows by their phasors and reduce their number; the result's rows are the old columns.
 * Item = CLR_WIDTH columns of one frequency of one block.
 *
 * g        float (n_parents, n_m, n_rows, 2, n_columns)
 * parent   int (n_blocks)
 * phasors  float (n_blocks, n_m, 2, n_phasors)
 * weights  float (n_rows, n_out)               n_out a multiple of CLR_TILE and of CLR_WIDTH
 * result   float (n_blocks, n_m, n_real_columns, 2, n_out)  out */
__kernel void reduce_and_transpose(const uint n_columns, const uint n_m, const uint n_blocks,
                                   const uint n_rows, const uint n_out,
                                   const uint n_real_columns, const uint n_phasors,
                                   __global const float *g, __global const int *parent,
                                   __global const float *phasors, __global const float *weights,
                                   __global float *result) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, m = (uint)get_global_id(1);
    const uint block = (uint)get_global_id(2);
    if (column >= n_real_columns || m >= n_m || block >= n_blocks) return;
    realw re[CLR_ROWS], im[CLR_ROWS];
    rotated_rows(n_rows, n_columns,
                 g + ((size_t)parent[block] * n_m + m) * 2 * n_rows * n_columns + column, n_phasors,
                 phasors + ((size_t)block * n_m + m) * 2 * n_phasors, re, im);
    __global float *out =
        result + (((size_t)block * n_m + m) * n_real_columns + column) * 2 * n_out;
    for (uint j = 0; j < n_out; j += CLR_TILE) {
        const weighted_sums sum = sum_rows(n_rows, re, im, weights + j, n_out);
#define FOUR(part, lane) (float4)(part[0] lane, part[1] lane, part[2] lane, part[3] lane)
#define STORE_LANE(number, lane)                                                                   \
    if (column + number < n_real_columns) {                                                        \
        __global float *at = out + (size_t)2 * number * n_out + j;                                 \
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
}

/* Multiply the rows by their phasors and reduce their number; columns stay columns. Arguments as above,
 * but every block has its own g, and result is float (n_blocks, n_m, n_out, 2, n_columns); weights have
 * n_padded columns, a multiple of CLR_TILE. */
__kernel void reduce_rows(const uint n_columns, const uint n_m, const uint n_blocks,
                          const uint n_rows, const uint n_out, const uint n_padded,
                          const uint n_phasors, __global const float *g,
                          __global const float *phasors, __global const float *weights,
                          __global float *result) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, m = (uint)get_global_id(1);
    const uint block = (uint)get_global_id(2);
    if (column >= n_columns || m >= n_m || block >= n_blocks) return;
    realw re[CLR_ROWS], im[CLR_ROWS];
    const size_t at = (size_t)block * n_m + m;
    rotated_rows(n_rows, n_columns, g + at * 2 * n_rows * n_columns + column, n_phasors,
                 phasors + at * 2 * n_phasors, re, im);
    __global float *out = result + at * 2 * n_out * n_columns + column;
    for (uint j = 0; j < n_padded; j += CLR_TILE) {
        const weighted_sums sum = sum_rows(n_rows, re, im, weights + j, n_padded);
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) {
            if (j + t >= n_out) continue;
            STOREW(sum.re[t], out + (size_t)2 * (j + t) * n_columns);
            STOREW(sum.im[t], out + (size_t)(2 * (j + t) + 1) * n_columns);
        }
    }
}

/* Reduce the number of frequencies. Item = CLR_WIDTH numbers of one block.
 *
 * g        float (n_blocks, n_m, n_values)     n_values a multiple of CLR_WIDTH
 * weights  float (n_m, n_padded)               n_padded a multiple of CLR_TILE
 * result   float (n_blocks, n_out, n_values)   out */
__kernel void reduce_frequencies(const uint n_values, const uint n_blocks, const uint n_m,
                                 const uint n_out, const uint n_padded, __global const float *g,
                                 __global const float *weights, __global float *result) {
    const uint value = (uint)get_global_id(0) * CLR_WIDTH, block = (uint)get_global_id(1);
    if (value >= n_values || block >= n_blocks) return;
    __global const float *in = g + (size_t)block * n_m * n_values + value;
    __global float *out = result + (size_t)block * n_out * n_values + value;
    for (uint j = 0; j < n_padded; j += CLR_TILE) {
        realw sum[CLR_TILE];
        for (uint t = 0; t < CLR_TILE; ++t) sum[t] = 0.0f;
        for (uint m = 0; m < n_m; ++m) {
            __global const float *w = weights + (size_t)m * n_padded + j;
            const realw a = LOADW(in + (size_t)m * n_values);
#pragma unroll
            for (uint t = 0; t < CLR_TILE; ++t) sum[t] = fused(a, (realw)(w[t]), sum[t]);
        }
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t)
            if (j + t < n_out) STOREW(sum[t], out + (size_t)(j + t) * n_values);
    }
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
    return length_difference(o.x + cx, o.y + cy, o.z + cz, cx, cy, cz, o.x, o.y, o.z);
#endif
}

/* The image in the smallest blocks. Item = CLR_WIDTH voxels of one block.
 *
 * offset   float (6, n_voxels)                 voxels from the block's centre, x, y, z as hi, then as lo,
 *                                              metres; n_voxels is a multiple of CLR_WIDTH
 * centres  float (n_blocks, 3)                 metres
 * rests    float (n_blocks, 3)                 exact centre minus its float32, metres
 * first    int (n_blocks, 3)                   x, y, z index of the block's first voxel
 * place    int (n_voxels, 3)                   x, y, z index of a voxel in its block
 * rows, columns  float (n, 6)                  antennas: x, y, z as hi, then as lo, metres
 * k        float (2, n_m)                      cycles per metre as hi, then lo
 * volume   float (2, n_z, n_y, n_x)            out: real, imaginary part */
__kernel void image_of_blocks(const uint n_voxels, const uint n_blocks, const uint n_m,
                              const uint n_rows, const uint n_columns, const uint n_padded,
                              const uint n_x, const uint n_y, const uint n_z,
                              __global const float *g, __global const float *offset,
                              __global const float *centres, __global const float *rests,
                              __global const int *first, __global const int *place,
                              __global const float *rows, __global const float *columns,
                              __global const float *k, __global float *volume) {
    const uint voxel = (uint)get_global_id(0) * CLR_WIDTH, block = (uint)get_global_id(1);
    if (voxel >= n_voxels || block >= n_blocks) return;
    __global const float *c = centres + 3 * block, *rest = rests + 3 * block;
    __global const float *at = offset + voxel;
    offsets o;
    o.x = LOADW(at) + rest[0];
    o.y = LOADW(at + n_voxels) + rest[1];
    o.z = LOADW(at + 2 * n_voxels) + rest[2];
#if CLR_FAR
    o.x_rest = LOADW(at + 3 * n_voxels) + ((LOADW(at) - o.x) + rest[0]);
    o.y_rest = LOADW(at + 4 * n_voxels) + ((LOADW(at + n_voxels) - o.y) + rest[1]);
    o.z_rest = LOADW(at + 5 * n_voxels) + ((LOADW(at + 2 * n_voxels) - o.z) + rest[2]);
#endif
    length_type row_m[CLR_LEAF], column_m[CLR_LEAF];
    realw column_re[CLR_LEAF], column_im[CLR_LEAF];
    for (uint i = 0; i < n_rows; ++i) row_m[i] = length_from_centre(o, c, rows + 6 * i);
    for (uint i = 0; i < n_columns; ++i) column_m[i] = length_from_centre(o, c, columns + 6 * i);
    realw sum_re = 0.0f, sum_im = 0.0f;
    __global const float *in = g + (size_t)block * n_m * n_rows * 2 * n_padded;
    for (uint m = 0; m < n_m; ++m) {
        for (uint i = 0; i < n_columns; ++i)
            phasor(column_m[i], k[m], k[n_m + m], &column_re[i], &column_im[i]);
        for (uint i = 0; i < n_rows; ++i) {
            realw re = 0.0f, im = 0.0f;
            for (uint j = 0; j < n_columns; ++j) {
                const realw a = in[j], b = in[n_padded + j];
                re = fused(a, column_re[j], fused(-b, column_im[j], re));
                im = fused(a, column_im[j], fused(b, column_re[j], im));
            }
            in += 2 * n_padded;
            realw cosine, sine;
            phasor(row_m[i], k[m], k[n_m + m], &cosine, &sine);
            sum_re = fused(re, cosine, fused(-im, sine, sum_re));
            sum_im = fused(re, sine, fused(im, cosine, sum_im));
        }
    }
    const size_t plane = (size_t)n_z * n_y * n_x;
#if CLR_WIDTH == 8
    float out_re[8], out_im[8];
    ((loose8 *)out_re)->v = sum_re;
    ((loose8 *)out_im)->v = sum_im;
#else
    const float out_re[1] = {sum_re}, out_im[1] = {sum_im};
#endif
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
        __global const int *s = place + 3 * (voxel + lane), *f = first + 3 * block;
        const uint x = (uint)(f[0] + s[0]), y = (uint)(f[1] + s[1]), z = (uint)(f[2] + s[2]);
        if (x < n_x && y < n_y && z < n_z) {
            const size_t index = ((size_t)z * n_y + y) * n_x + x;
            volume[index] = out_re[lane];
            volume[plane + index] = out_im[lane];
        }
    }
}

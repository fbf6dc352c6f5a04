/* Back-projection over a tree of blocks of voxels. Seen from a block with centre c, once every path is
 * turned to the length that it has for c, the sum
 *     V(v) = sum_{t, r, m} G[m, t, r] exp(+j 2 pi k_m (|v - t| - |c - t| + |v - r| - |c - r|))
 * varies slowly over antennas and frequencies, and a few of either stand for all: the others' terms are
 * given to them by the weights of an interpolation (clradar/skeleton.py). From a block to the smaller
 * blocks in it, G is turned to their centres and reduced to fewer rows, columns and frequencies; in the
 * smallest blocks V is summed as it stands. Rows and columns (transmitters and receivers, or the other
 * way round) change places from level to level, so that the sum over rows is always the first one.
 *
 * G  float (n_blocks, n_m, n_rows, 2, n_columns): real and imaginary parts of a row side by side; rows
 *    are padded with zeros to a multiple of CLR_WIDTH and of TILE columns. */
#ifndef CLR_ROWS
#error "CLR_ROWS (most rows of a block: they are held in private memory) is missing"
#endif
#ifndef CLR_LEAF
#error "CLR_LEAF (most rows or columns of a smallest block, held in private memory) is missing"
#endif
#ifndef CLR_FAR
#error "CLR_FAR (1 where float32 is too coarse for the phase over a block) is missing"
#endif

#include "common/phase.h"

#define TILE 4 /* rows of the result that one pass makes */

#if CLR_FAR
/* Over blocks of many wavelengths a float32 has no digits left for the phase: lengths and wavenumbers are
 * kept as hi + lo. */
typedef dual leglength;

/* The coordinate of a place, given as at + rest, from an antenna. */
static inline dual from_antenna(realw at, realw rest, realw hi, realw lo) {
    dual d = two_sum(at, -hi);
    d.lo += rest - lo;
    return d;
}

static inline dual leg_difference(dual vx, dual vy, dual vz, dual cx, dual cy, dual cz) {
    const dual v = dual_length(vx, vy, vz), c = dual_length(cx, cy, cz);
    dual d = two_sum(v.hi, -c.hi);
    d.lo += v.lo - c.lo;
    return two_sum(d.hi, d.lo);
}

static inline void cos_sin_of(dual length, float k_hi, float k_lo, realw *cosine, realw *sine) {
    cos_sin_cycles(cycles(length, make_wavenumber((realw)(k_hi), (realw)(k_lo))), cosine, sine);
}
#else
typedef realw leglength;

/* x reduced to half a turn, for |x| < 2^22. */
static inline realw one_turn(realw x) {
    const realw magic = 12582912.0f;
    return x - ((x + magic) - magic);
}

static inline void cos_sin_of(realw length, float k_hi, float k_lo, realw *cosine, realw *sine) {
    cos_sin_cycles(one_turn(length * k_hi), cosine, sine);
}
#endif

/* How each antenna's phase turns from a block's centre to that of a block in it. Item = CLR_WIDTH
 * antennas of one block.
 *
 * antennas  float (6, n_columns)               x, y, z as hi, then as lo, metres; n_columns a multiple of
 *                                              CLR_WIDTH
 * k         float (2, n_m)                     cycles per metre as hi, then lo
 * centres   float (n_blocks, 3)                metres
 * parents   float (n_parents, 3)
 * parent    int (n_blocks)
 * turns     float (n_blocks, n_m, 2, n_columns)  out: cosine, sine */
__kernel void block_turns(const uint n_columns, const uint n_blocks, const uint n_m,
                          __global const float *antennas, __global const float *k,
                          __global const float *centres, __global const float *parents,
                          __global const int *parent, __global float *turns) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, block = (uint)get_global_id(1);
    if (column >= n_columns || block >= n_blocks) return;
    const realw ax = LOADW(antennas + column), ay = LOADW(antennas + n_columns + column);
    const realw az = LOADW(antennas + 2 * n_columns + column);
    __global const float *c = centres + 3 * block, *p = parents + 3 * parent[block];
#if CLR_FAR
    const realw bx = LOADW(antennas + 3 * n_columns + column);
    const realw by = LOADW(antennas + 4 * n_columns + column);
    const realw bz = LOADW(antennas + 5 * n_columns + column), none = 0.0f;
    const dual length = leg_difference(
        from_antenna(c[0], none, ax, bx), from_antenna(c[1], none, ay, by),
        from_antenna(c[2], none, az, bz), from_antenna(p[0], none, ax, bx),
        from_antenna(p[1], none, ay, by), from_antenna(p[2], none, az, bz));
#else
    const realw cx = c[0] - ax, cy = c[1] - ay, cz = c[2] - az;
    const realw px = p[0] - ax, py = p[1] - ay, pz = p[2] - az;
    const realw lengths = sqrt(cx * cx + cy * cy + cz * cz) + sqrt(px * px + py * py + pz * pz);
    /* The difference of two lengths, without cancellation. */
    const realw product =
        (c[0] - p[0]) * (cx + px) + (c[1] - p[1]) * (cy + py) + (c[2] - p[2]) * (cz + pz);
    const realw length = lengths > 0.0f ? product / lengths : (realw)(0.0f);
#endif
    __global float *out = turns + (size_t)2 * block * n_m * n_columns + column;
    for (uint m = 0; m < n_m; ++m) {
        realw cosine, sine;
        cos_sin_of(length, k[m], k[n_m + m], &cosine, &sine);
        STOREW(cosine, out);
        STOREW(sine, out + n_columns);
        out += 2 * n_columns;
    }
}

/* Rows of one block and frequency, CLR_WIDTH columns of them, times their turns. */
static inline void turned_rows(const uint n_rows, const uint n_columns, __global const float *g,
                               const uint n_turns, __global const float *turns, realw *re,
                               realw *im) {
    for (uint i = 0; i < n_rows; ++i) {
        const realw a = LOADW(g + (size_t)2 * i * n_columns);
        const realw b = LOADW(g + (size_t)(2 * i + 1) * n_columns);
        const realw cosine = turns[i], sine = turns[n_turns + i];
        re[i] = fused(a, cosine, -(b * sine));
        im[i] = fused(a, sine, b * cosine);
    }
}

/* Turn the rows and reduce their number; the result's rows are the old columns. Item = CLR_WIDTH columns
 * of one frequency of one block.
 *
 * g        float (n_parents, n_m, n_rows, 2, n_columns)
 * parent   int (n_blocks)
 * turns    float (n_blocks, n_m, 2, n_turns)
 * weights  float (n_rows, n_out)               n_out a multiple of TILE and of CLR_WIDTH
 * result   float (n_blocks, n_m, n_real_columns, 2, n_out)  out */
__kernel void reduce_and_swap(const uint n_columns, const uint n_m, const uint n_blocks,
                              const uint n_rows, const uint n_out, const uint n_real_columns,
                              const uint n_turns, __global const float *g,
                              __global const int *parent, __global const float *turns,
                              __global const float *weights, __global float *result) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, m = (uint)get_global_id(1);
    const uint block = (uint)get_global_id(2);
    if (column >= n_real_columns || m >= n_m || block >= n_blocks) return;
    realw re[CLR_ROWS], im[CLR_ROWS];
    turned_rows(n_rows, n_columns,
                g + ((size_t)parent[block] * n_m + m) * 2 * n_rows * n_columns + column, n_turns,
                turns + ((size_t)block * n_m + m) * 2 * n_turns, re, im);
    __global float *out =
        result + (((size_t)block * n_m + m) * n_real_columns + column) * 2 * n_out;
    for (uint j = 0; j < n_out; j += TILE) {
        realw r0 = 0.0f, r1 = 0.0f, r2 = 0.0f, r3 = 0.0f;
        realw i0 = 0.0f, i1 = 0.0f, i2 = 0.0f, i3 = 0.0f;
        for (uint i = 0; i < n_rows; ++i) {
            __global const float *w = weights + (size_t)i * n_out + j;
            const realw a = re[i], b = im[i];
            const realw w0 = w[0], w1 = w[1], w2 = w[2], w3 = w[3];
            r0 = fused(a, w0, r0);
            i0 = fused(b, w0, i0);
            r1 = fused(a, w1, r1);
            i1 = fused(b, w1, i1);
            r2 = fused(a, w2, r2);
            i2 = fused(b, w2, i2);
            r3 = fused(a, w3, r3);
            i3 = fused(b, w3, i3);
        }
#if CLR_WIDTH == 8
        const uint left = n_real_columns - column;
#define STORE_LANE(lane)                                                                           \
    if (lane < left) {                                                                             \
        __global float *at = out + (size_t)2 * lane * n_out + j;                                   \
        ((__global loose4 *)at)->v = (float4)(r0.s##lane, r1.s##lane, r2.s##lane, r3.s##lane);     \
        ((__global loose4 *)(at + n_out))->v =                                                     \
            (float4)(i0.s##lane, i1.s##lane, i2.s##lane, i3.s##lane);                              \
    }
        STORE_LANE(0)
        STORE_LANE(1)
        STORE_LANE(2)
        STORE_LANE(3)
        STORE_LANE(4)
        STORE_LANE(5)
        STORE_LANE(6)
        STORE_LANE(7)
#else
        ((__global loose4 *)(out + j))->v = (float4)(r0, r1, r2, r3);
        ((__global loose4 *)(out + n_out + j))->v = (float4)(i0, i1, i2, i3);
#endif
    }
}

/* Turn the rows and reduce their number; columns stay columns. Arguments as above, but every block has
 * its own g, and result is float (n_blocks, n_m, n_out, 2, n_columns); weights have n_padded columns, a
 * multiple of TILE. */
__kernel void reduce_rows(const uint n_columns, const uint n_m, const uint n_blocks,
                          const uint n_rows, const uint n_out, const uint n_padded,
                          const uint n_turns, __global const float *g, __global const float *turns,
                          __global const float *weights, __global float *result) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, m = (uint)get_global_id(1);
    const uint block = (uint)get_global_id(2);
    if (column >= n_columns || m >= n_m || block >= n_blocks) return;
    realw re[CLR_ROWS], im[CLR_ROWS];
    const size_t at = (size_t)block * n_m + m;
    turned_rows(n_rows, n_columns, g + at * 2 * n_rows * n_columns + column, n_turns,
                turns + at * 2 * n_turns, re, im);
    __global float *out = result + at * 2 * n_out * n_columns + column;
    for (uint j = 0; j < n_padded; j += TILE) {
        realw r0 = 0.0f, r1 = 0.0f, r2 = 0.0f, r3 = 0.0f;
        realw i0 = 0.0f, i1 = 0.0f, i2 = 0.0f, i3 = 0.0f;
        for (uint i = 0; i < n_rows; ++i) {
            __global const float *w = weights + (size_t)i * n_padded + j;
            const realw a = re[i], b = im[i];
            const realw w0 = w[0], w1 = w[1], w2 = w[2], w3 = w[3];
            r0 = fused(a, w0, r0);
            i0 = fused(b, w0, i0);
            r1 = fused(a, w1, r1);
            i1 = fused(b, w1, i1);
            r2 = fused(a, w2, r2);
            i2 = fused(b, w2, i2);
            r3 = fused(a, w3, r3);
            i3 = fused(b, w3, i3);
        }
        __global float *row = out + (size_t)2 * j * n_columns;
        const size_t step = (size_t)2 * n_columns;
        STOREW(r0, row);
        STOREW(i0, row + n_columns);
        if (j + 1 < n_out) {
            STOREW(r1, row + step);
            STOREW(i1, row + step + n_columns);
        }
        if (j + 2 < n_out) {
            STOREW(r2, row + 2 * step);
            STOREW(i2, row + 2 * step + n_columns);
        }
        if (j + 3 < n_out) {
            STOREW(r3, row + 3 * step);
            STOREW(i3, row + 3 * step + n_columns);
        }
    }
}

/* Reduce the number of frequencies. Item = CLR_WIDTH numbers of one block.
 *
 * g        float (n_blocks, n_m, n_values)     n_values a multiple of CLR_WIDTH
 * weights  float (n_m, n_padded)               n_padded a multiple of TILE
 * result   float (n_blocks, n_out, n_values)   out */
__kernel void reduce_frequencies(const uint n_values, const uint n_blocks, const uint n_m,
                                 const uint n_out, const uint n_padded, __global const float *g,
                                 __global const float *weights, __global float *result) {
    const uint value = (uint)get_global_id(0) * CLR_WIDTH, block = (uint)get_global_id(1);
    if (value >= n_values || block >= n_blocks) return;
    __global const float *in = g + (size_t)block * n_m * n_values + value;
    __global float *out = result + (size_t)block * n_out * n_values + value;
    for (uint j = 0; j < n_padded; j += TILE) {
        realw s0 = 0.0f, s1 = 0.0f, s2 = 0.0f, s3 = 0.0f;
        for (uint m = 0; m < n_m; ++m) {
            __global const float *w = weights + (size_t)m * n_padded + j;
            const realw a = LOADW(in + (size_t)m * n_values);
            s0 = fused(a, (realw)(w[0]), s0);
            s1 = fused(a, (realw)(w[1]), s1);
            s2 = fused(a, (realw)(w[2]), s2);
            s3 = fused(a, (realw)(w[3]), s3);
        }
        STOREW(s0, out + (size_t)j * n_values);
        if (j + 1 < n_out) STOREW(s1, out + (size_t)(j + 1) * n_values);
        if (j + 2 < n_out) STOREW(s2, out + (size_t)(j + 2) * n_values);
        if (j + 3 < n_out) STOREW(s3, out + (size_t)(j + 3) * n_values);
    }
}

/* CLR_WIDTH voxels of a block with centre c, from there, metres: what float32 leaves of a coordinate is
 * told by CLR_FAR only. */
typedef struct {
    realw x, y, z;
#if CLR_FAR
    realw x_rest, y_rest, z_rest;
#endif
} offsets;

/* |v - a| - |c - a| per lane, for v = c + o and an antenna float (6): x, y, z as hi, then as lo. */
static inline leglength leg_from_centre(const offsets o, __global const float *c,
                                        __global const float *a) {
#if CLR_FAR
    const realw none = 0.0f;
    const dual cx = from_antenna(c[0], none, a[0], a[3]);
    const dual cy = from_antenna(c[1], none, a[1], a[4]);
    const dual cz = from_antenna(c[2], none, a[2], a[5]);
    const dual ox = {o.x, o.x_rest}, oy = {o.y, o.y_rest}, oz = {o.z, o.z_rest};
    return leg_difference(dual_add(cx, ox), dual_add(cy, oy), dual_add(cz, oz), cx, cy, cz);
#else
    const float cx = c[0] - a[0], cy = c[1] - a[1], cz = c[2] - a[2];
    const realw vx = o.x + cx, vy = o.y + cy, vz = o.z + cz;
    const realw lengths =
        sqrt(vx * vx + vy * vy + vz * vz) + sqrt((realw)(cx * cx + cy * cy + cz * cz));
    const realw product = o.x * (vx + cx) + o.y * (vy + cy) + o.z * (vz + cz);
    return lengths > 0.0f ? product / lengths : (realw)(0.0f);
#endif
}

/* The image in the smallest blocks. Item = CLR_WIDTH voxels of one block.
 *
 * offset   float (6, n_voxels)                 voxels from the block's centre, x, y, z as hi, then as lo,
 *                                              metres; n_voxels is a multiple of CLR_WIDTH
 * centres  float (n_blocks, 3)                 metres
 * rests    float (n_blocks, 3)                 what the centre's float32 leaves of it, metres
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
    leglength row_m[CLR_LEAF], column_m[CLR_LEAF];
    realw column_re[CLR_LEAF], column_im[CLR_LEAF];
    for (uint i = 0; i < n_rows; ++i) row_m[i] = leg_from_centre(o, c, rows + 6 * i);
    for (uint i = 0; i < n_columns; ++i) column_m[i] = leg_from_centre(o, c, columns + 6 * i);
    realw sum_re = 0.0f, sum_im = 0.0f;
    __global const float *in = g + (size_t)block * n_m * n_rows * 2 * n_padded;
    for (uint m = 0; m < n_m; ++m) {
        for (uint i = 0; i < n_columns; ++i)
            cos_sin_of(column_m[i], k[m], k[n_m + m], &column_re[i], &column_im[i]);
        for (uint i = 0; i < n_rows; ++i) {
            realw re = 0.0f, im = 0.0f;
            for (uint j = 0; j < n_columns; ++j) {
                const realw a = in[j], b = in[n_padded + j];
                re = fused(a, column_re[j], fused(-b, column_im[j], re));
                im = fused(a, column_im[j], fused(b, column_re[j], im));
            }
            in += 2 * n_padded;
            realw cosine, sine;
            cos_sin_of(row_m[i], k[m], k[n_m + m], &cosine, &sine);
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

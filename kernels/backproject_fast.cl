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
#include "common/block_phases.h"

/* The phasors that refer the samples of CLR_WIDTH antennas from the centre p of a block to that of a block
 * in it, c. Arguments as below. */
static inline void antenna_phasors(const uint n_columns, const uint n_m,
                                   __global const float *antennas, __global const float *k,
                                   __global const float *c, __global const float *p,
                                   __global float *out) {
    const realw ax = LOADW(antennas), ay = LOADW(antennas + n_columns);
    const realw az = LOADW(antennas + 2 * n_columns);
#if CLR_FAR
    const realw bx = LOADW(antennas + 3 * n_columns);
    const realw by = LOADW(antennas + 4 * n_columns);
    const realw bz = LOADW(antennas + 5 * n_columns), none = 0.0f;
    const dual length = length_difference(
        from_antenna(c[0], none, ax, bx), from_antenna(c[1], none, ay, by),
        from_antenna(c[2], none, az, bz), from_antenna(p[0], none, ax, bx),
        from_antenna(p[1], none, ay, by), from_antenna(p[2], none, az, bz));
#else
    const realw px = p[0] - ax, py = p[1] - ay, pz = p[2] - az;
    const realw length =
        length_difference(c[0] - ax, c[1] - ay, c[2] - az, px, py, pz, c[0] - p[0], c[1] - p[1],
                          c[2] - p[2], sqrt(px * px + py * py + pz * pz));
#endif
    for (uint m = 0; m < n_m; ++m) {
        realw cosine, sine;
        phasor(length, k[m], k[n_m + m], &cosine, &sine);
        STOREW(cosine, out);
        STOREW(sine, out + n_columns);
        out += 2 * n_columns;
    }
}

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
    antenna_phasors(n_columns, n_m, antennas + column, k, centres + 3 * block,
                    parents + 3 * parent[block],
                    phasors + (size_t)2 * block * n_m * n_columns + column);
}

/* CLR_WIDTH columns of one frequency become rows: arguments as below, from this block, frequency and column
 * on; n_left columns from here on are real. */
static inline void transposed_columns(const uint n_columns, const uint n_rows, const uint n_out,
                                      const uint n_left, const uint n_phasors,
                                      __global const float *g, __global const float *phasors,
                                      __global const float *weights, __global float *out) {
    row_set rows;
    rows.g = g;
    rows.phasors = phasors;
    rows.n_columns = n_columns;
    rows.n_phasors = n_phasors;
    hold_rows(&rows, n_rows);
#if CLR_WIDTH == 8
    /* CLR_WIDTH sums of a column side by side, which nothing has to transpose. */
    for (uint t0 = 0; t0 < CLR_WIDTH && t0 < n_left; t0 += CLR_TILE)
        for (uint j = 0; j < n_out; j += CLR_WIDTH) {
            weighted_sums sum;
#pragma unroll
            for (uint t = 0; t < CLR_TILE; ++t) sum.re[t] = sum.im[t] = 0.0f;
            for (uint i = 0; i < n_rows; ++i) {
                const realw w = LOADW(weights + (size_t)i * n_out + j);
                const float *a = (const float *)&rows.re[i] + t0;
                const float *b = (const float *)&rows.im[i] + t0;
#pragma unroll
                for (uint t = 0; t < CLR_TILE; ++t) {
                    sum.re[t] = fused((realw)(a[t]), w, sum.re[t]);
                    sum.im[t] = fused((realw)(b[t]), w, sum.im[t]);
                }
            }
#pragma unroll
            for (uint t = 0; t < CLR_TILE; ++t) {
                if (t0 + t >= n_left) continue;
                STOREW(sum.re[t], out + (size_t)2 * (t0 + t) * n_out + j);
                STOREW(sum.im[t], out + (size_t)(2 * (t0 + t) + 1) * n_out + j);
            }
        }
#else
    for (uint j = 0; j < n_out; j += CLR_TILE) {
        const weighted_sums sum = sum_rows(n_rows, &rows, weights + j, n_out);
        store_transposed(sum, n_left, n_out, out + j);
    }
#endif
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
    transposed_columns(n_columns, n_rows, n_out, n_real_columns - column, n_phasors,
                       g + ((size_t)parent[block] * n_m + m) * 2 * n_rows * n_columns + column,
                       phasors + ((size_t)block * n_m + m) * 2 * n_phasors, weights,
                       result +
                           (((size_t)block * n_m + m) * n_real_columns + column) * 2 * n_out);
}

/* CLR_WIDTH columns of one frequency with fewer rows: arguments as below, from this block, frequency and
 * column on. */
static inline void fewer_rows(const uint n_columns, const uint n_rows, const uint n_out,
                              const uint n_padded, const uint n_phasors, __global const float *g,
                              __global const float *phasors, __global const float *weights,
                              __global float *out) {
    row_set rows;
    rows.g = g;
    rows.phasors = phasors;
    rows.n_columns = n_columns;
    rows.n_phasors = n_phasors;
    hold_rows(&rows, n_rows);
    for (uint j = 0; j < n_padded; j += CLR_TILE) {
        const weighted_sums sum = sum_rows(n_rows, &rows, weights + j, n_padded);
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) {
            if (j + t >= n_out) continue;
            STOREW(sum.re[t], out + (size_t)2 * (j + t) * n_columns);
            STOREW(sum.im[t], out + (size_t)(2 * (j + t) + 1) * n_columns);
        }
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
    const size_t at = (size_t)block * n_m + m;
    fewer_rows(n_columns, n_rows, n_out, n_padded, n_phasors, g + at * 2 * n_rows * n_columns + column,
               phasors + at * 2 * n_phasors, weights, result + at * 2 * n_out * n_columns + column);
}

/* CLR_WIDTH numbers of fewer frequencies: arguments as below, from this block and number on. */
static inline void fewer_frequencies(const uint n_values, const uint n_m, const uint n_out,
                                     const uint n_padded, __global const float *in,
                                     __global const float *weights, __global float *out) {
    for (uint j = 0; j < n_padded; j += CLR_TILE) {
        realw sum[CLR_TILE];
#pragma unroll
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
    fewer_frequencies(n_values, n_m, n_out, n_padded, g + (size_t)block * n_m * n_values + value,
                      weights, result + (size_t)block * n_out * n_values + value);
}

/* The same of 2 CLR_WIDTH numbers, whose sums need not wait for one another. */
static inline void fewer_frequencies_of_two(const uint n_values, const uint n_m, const uint n_out,
                                            const uint n_padded, __global const float *in,
                                            __global const float *weights, __global float *out) {
    for (uint j = 0; j < n_padded; j += CLR_TILE) {
        realw one[CLR_TILE], two[CLR_TILE];
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) one[t] = two[t] = 0.0f;
        for (uint m = 0; m < n_m; ++m) {
            __global const float *w = weights + (size_t)m * n_padded + j;
            const realw a = LOADW(in + (size_t)m * n_values);
            const realw b = LOADW(in + (size_t)m * n_values + CLR_WIDTH);
#pragma unroll
            for (uint t = 0; t < CLR_TILE; ++t) {
                one[t] = fused(a, (realw)(w[t]), one[t]);
                two[t] = fused(b, (realw)(w[t]), two[t]);
            }
        }
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) {
            if (j + t >= n_out) continue;
            STOREW(one[t], out + (size_t)(j + t) * n_values);
            STOREW(two[t], out + (size_t)(j + t) * n_values + CLR_WIDTH);
        }
    }
}

/* All of the above, block by block: what one block needs on the way stays in a core's cache, and the three
 * steps are one launch. Item = every n_items-th block. For devices whose items are a core's lanes.
 *
 * n_columns, n_rows, n_skeleton                columns and rows of the parents, and columns left
 * n_new, n_new_rows                            rows left, padded: the columns of the result
 * row_antennas, column_antennas, centres, parents, parent, k   see block_phasors
 * g              float (n_parents, n_m, n_rows, 2, padded n_columns)
 * scratch        float (n_items, n_scratch)
 * result         float (n_blocks, n_left, n_skeleton, 2, n_new)  out */
__kernel void reduce_blocks(const uint n_items, const uint n_blocks, const uint n_m,
                            const uint n_rows, const uint n_columns, const uint n_new,
                            const uint n_skeleton, const uint n_left, const uint n_scratch,
                            __global const float *row_antennas,
                            __global const float *column_antennas, __global const float *k,
                            __global const float *centres, __global const float *parents,
                            __global const int *parent, __global const float *g,
                            __global const float *row_weights,
                            __global const float *column_weights,
                            __global const float *frequency_weights, __global float *scratch,
                            __global float *result) {
    const uint item = (uint)get_global_id(0);
    if (item >= n_items) return;
    const uint unit = CLR_WIDTH > CLR_TILE ? CLR_WIDTH : CLR_TILE;
    const uint n_row_phasors = (n_rows + unit - 1) / unit * unit;
    const uint n_padded_columns = (n_columns + unit - 1) / unit * unit;
    const uint n_padded_skeleton = (n_skeleton + CLR_TILE - 1) / CLR_TILE * CLR_TILE;
    const uint n_padded_left = (n_left + CLR_TILE - 1) / CLR_TILE * CLR_TILE;
    const uint n_values = 2 * n_skeleton * n_new;
    __global float *row_phasors = scratch + (size_t)item * n_scratch;
    __global float *column_phasors = row_phasors + 2 * n_m * n_row_phasors;
    __global float *transposed = column_phasors + 2 * n_m * n_padded_columns;
    __global float *reduced = transposed + 2 * n_columns * n_new;
    for (uint block = item; block < n_blocks; block += n_items) {
        __global const float *c = centres + 3 * block, *p = parents + 3 * parent[block];
        for (uint at = 0; at < n_row_phasors; at += CLR_WIDTH)
            antenna_phasors(n_row_phasors, n_m, row_antennas + at, k, c, p, row_phasors + at);
        for (uint at = 0; at < n_padded_columns; at += CLR_WIDTH)
            antenna_phasors(n_padded_columns, n_m, column_antennas + at, k, c, p,
                            column_phasors + at);
        for (uint m = 0; m < n_m; ++m) {
            __global const float *from =
                g + ((size_t)parent[block] * n_m + m) * 2 * n_rows * n_padded_columns;
            for (uint at = 0; at < n_columns; at += CLR_WIDTH)
                transposed_columns(n_padded_columns, n_rows, n_new, n_columns - at, n_row_phasors,
                                   from + at, row_phasors + 2 * m * n_row_phasors, row_weights,
                                   transposed + 2 * at * n_new);
            for (uint at = 0; at < n_new; at += CLR_WIDTH)
                fewer_rows(n_new, n_columns, n_skeleton, n_padded_skeleton, n_padded_columns,
                           transposed + at, column_phasors + 2 * m * n_padded_columns,
                           column_weights, reduced + (size_t)m * n_values + at);
        }
        /* n_values is twice a multiple of CLR_WIDTH. */
        for (uint at = 0; at < n_values; at += 2 * CLR_WIDTH)
            fewer_frequencies_of_two(n_values, n_m, n_left, n_padded_left, reduced + at,
                                     frequency_weights,
                                     result + (size_t)block * n_left * n_values + at);
    }
}

#if CLR_KEPT
/* Cycles of a plane wave from a block's centre to voxels. */
static inline realw wave_cycles(__global const float *wave, realw x, realw y, realw z) {
    return fused((realw)(wave[0]), x, fused((realw)(wave[1]), y, wave[2] * z));
}
#endif

/* Add n rows of one frequency to CLR_WIDTH voxels, one after the other. A macro, since a compiler keeps the sums in
 * registers only where it sees that n is a constant before it unrolls. */
#define ADD_ROWS(n)                                                                                \
    {                                                                                              \
        realw re[n], im[n];                                                                        \
        _Pragma("unroll") for (uint t = 0; t < n; ++t) re[t] = im[t] = 0.0f;                       \
        for (uint j = 0; j < n_columns; ++j) {                                                     \
            const realw c = column_re[j], s = column_im[j];                                        \
            _Pragma("unroll") for (uint t = 0; t < n; ++t) {                                       \
                const realw a = in[2 * t * n_padded + j], b = in[(2 * t + 1) * n_padded + j];      \
                re[t] = fused(a, c, fused(-b, s, re[t]));                                          \
                im[t] = fused(a, s, fused(b, c, im[t]));                                           \
            }                                                                                      \
        }                                                                                          \
        _Pragma("unroll") for (uint t = 0; t < n; ++t) {                                           \
            realw cosine, sine;                                                                    \
            phasor(row_m[i + t], k[m], k[n_m + m], &cosine, &sine);                                \
            sum_re = fused(re[t], cosine, fused(-im[t], sine, sum_re));                            \
            sum_im = fused(re[t], sine, fused(im[t], cosine, sum_im));                             \
        }                                                                                          \
        in += 2 * n * n_padded;                                                                    \
        i += n;                                                                                    \
    }

/* The image in the smallest blocks. Item = CLR_WIDTH voxels or points of one block. With CLR_KEPT they are the skeleton
 * voxels of each block, and the image is relative to a plane wave through the block's centre.
 *
 * n_voxels                                     most voxels of a block, whole lanes
 * offset, rests (n_blocks, 3), first (n_blocks, 3), place   see common/block_phases.h
 * centres  float (n_blocks, 3)                 metres
 * rows, columns  float (n, 6)                  antennas: x, y, z as hi, then as lo, metres
 * k        float (2, n_m)                      cycles per metre as hi, then lo
 * waves    float (n_blocks, 3)                 with CLR_KEPT: cycles per metre of the plane waves
 * volume   float (2, n_z, n_y, n_x)            out: real, imaginary part; n_x points, n_y = n_z = 1
 *          float (n_z, n_y, 2, n_x / 2)        with CLR_KEPT: n_y rows of skeleton voxels, and block after block */
__kernel void image_of_blocks(const uint n_voxels, const uint n_blocks, const uint n_m,
                              const uint n_rows, const uint n_columns, const uint n_padded,
                              const uint n_x, const uint n_y, const uint n_z, const uint n_offsets,
                              __global const float *g, __global const float *offset,
                              __global const float *centres, __global const float *rests,
                              __global const int *first, __global const int *place,
                              __global const float *rows, __global const float *columns,
                              __global const float *k,
#if CLR_KEPT
                              __global const float *waves,
#endif
                              __global float *volume) {
    const uint voxel = (uint)get_global_id(0) * CLR_WIDTH, block = (uint)get_global_id(1);
    __global const int *from = first + 3 * block;
    if (block >= n_blocks || voxel >= leaf_size(n_voxels, from)) return;
    __global const float *c = centres + 3 * block, *rest = rests + 3 * block;
    const offsets o = load_offsets(n_offsets, voxel, offset, rest, from);
    length_type row_m[CLR_LEAF], column_m[CLR_LEAF];
    realw column_re[CLR_LEAF], column_im[CLR_LEAF];
    for (uint i = 0; i < n_rows; ++i) row_m[i] = length_from_centre(o, c, rows + 6 * i);
    for (uint i = 0; i < n_columns; ++i) column_m[i] = length_from_centre(o, c, columns + 6 * i);
    realw sum_re = 0.0f, sum_im = 0.0f;
    __global const float *in = g + (size_t)block * n_m * n_rows * 2 * n_padded;
    for (uint m = 0; m < n_m; ++m) {
        for (uint i = 0; i < n_columns; ++i)
            phasor(column_m[i], k[m], k[n_m + m], &column_re[i], &column_im[i]);
        uint i = 0;
        while (i < n_rows) {
#if CLR_WIDTH == 8
            const uint left = n_rows - i;
            if (left == 4 || left > 5) {
                ADD_ROWS(4)
                continue;
            }
            if (left > 2) {
                ADD_ROWS(3)
                continue;
            }
            if (left == 2) {
                ADD_ROWS(2)
                continue;
            }
#endif
            ADD_ROWS(1)
        }
    }
#if CLR_KEPT
    const size_t plane = n_x / 2;
    realw cosine, sine;
    /* Without the rests, as in voxels_of_blocks. */
    cos_sin_of(-wave_cycles(waves + 3 * block, LOADW(offset + voxel),
                            LOADW(offset + n_offsets + voxel),
                            LOADW(offset + 2 * n_offsets + voxel)),
               1.0f, &cosine, &sine);
    const realw turned = fused(sum_re, cosine, -(sum_im * sine));
    sum_im = fused(sum_re, sine, sum_im * cosine);
    sum_re = turned;
#else
    const size_t plane = (size_t)n_z * n_y * n_x;
#endif
#if CLR_WIDTH == 8
    float out_re[8], out_im[8];
    ((loose8 *)out_re)->v = sum_re;
    ((loose8 *)out_im)->v = sum_im;
#else
    const float out_re[1] = {sum_re}, out_im[1] = {sum_im};
#endif
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
        const long index = leaf_index(n_x, n_y, n_z, voxel + lane, from, place);
        if (index >= 0) {
            volume[index] = out_re[lane];
            volume[plane + index] = out_im[lane];
        }
    }
}

#if CLR_KEPT
/* The image in all voxels of the smallest blocks from that in skeleton voxels, which reduce_frequencies has spread
 * along z. Item = every n_items-th row of voxels in one plane of one block.
 *
 * n_kept_y, n_row                              rows of skeleton voxels in a plane, and numbers in a row
 * n_kept                                       skeleton voxels of a row
 * n_bx, n_by, n_bz                             voxels of a block
 * n_padded                                     n_bx, whole lanes
 * first    int (n_blocks, 3)                   x, y, z index of each block's first voxel
 * waves    float (n_blocks, 3)                 cycles per metre
 * offset   float (n_padded + n_by + n_bz)      x, y, z from the block's centre, metres
 * x_weights  float (n_kept, n_padded)
 * y_weights  float (n_kept_y, n_by)
 * planes   float (n_blocks, n_bz, n_kept_y, n_row)  a row: real parts, from n_row / 2 on imaginary parts
 * volume   float (2, n_z, n_y, n_x)            out */
__kernel void voxels_of_blocks(const uint n_items, const uint n_blocks, const uint n_kept_y,
                               const uint n_row, const uint n_kept, const uint n_bx,
                               const uint n_by, const uint n_bz, const uint n_padded,
                               const uint n_x, const uint n_y, const uint n_z,
                               __global const int *first, __global const float *waves,
                               __global const float *offset, __global const float *x_weights,
                               __global const float *y_weights, __global const float *planes,
                               __global float *volume) {
    const uint item = (uint)get_global_id(0), plane = (uint)get_global_id(1);
    const uint block = (uint)get_global_id(2);
    if (item >= n_items || plane >= n_bz || block >= n_blocks) return;
    const uint x0 = (uint)first[3 * block], y0 = (uint)first[3 * block + 1];
    const uint z = (uint)first[3 * block + 2] + plane;
    if (z >= n_z) return;
    const size_t n_volume = (size_t)n_z * n_y * n_x;
    __global const float *in = planes + ((size_t)block * n_bz + plane) * n_kept_y * n_row;
    float row[2 * CLR_KEPT];
    for (uint y = item; y < n_by && y0 + y < n_y; y += n_items) {
        for (uint v = 0; v < n_row; v += CLR_WIDTH) {
            realw sum = 0.0f;
            for (uint j = 0; j < n_kept_y; ++j)
                sum = fused(LOADW(in + j * n_row + v), (realw)(y_weights[j * n_by + y]), sum);
#if CLR_WIDTH == 8
            ((loose8 *)(row + v))->v = sum;
#else
            row[v] = sum;
#endif
        }
        __global float *out = volume + ((size_t)z * n_y + y0 + y) * n_x + x0;
        for (uint x = 0; x < n_bx && x0 + x < n_x; x += CLR_WIDTH) {
            realw re = 0.0f, im = 0.0f, cosine, sine;
            for (uint j = 0; j < n_kept; ++j) {
                const realw w = LOADW(x_weights + j * n_padded + x);
                re = fused((realw)(row[j]), w, re);
                im = fused((realw)(row[n_row / 2 + j]), w, im);
            }
            const realw cycles =
                wave_cycles(waves + 3 * block, LOADW(offset + x), offset[n_padded + y],
                            offset[n_padded + n_by + plane]);
            cos_sin_of(cycles, 1.0f, &cosine, &sine);
            const realw turned_re = fused(re, cosine, -(im * sine));
            const realw turned_im = fused(re, sine, im * cosine);
            if (x + CLR_WIDTH <= n_bx && x0 + x + CLR_WIDTH <= n_x) {
                STOREW(turned_re, out + x);
                STOREW(turned_im, out + n_volume + x);
                continue;
            }
            for (uint lane = 0; x + lane < n_bx && x0 + x + lane < n_x; ++lane) {
                out[x + lane] = LANE(turned_re, lane);
                out[n_volume + x + lane] = LANE(turned_im, lane);
            }
        }
    }
}
#endif

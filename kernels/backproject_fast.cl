/* Fast factorised back-projection (Ulander, Hellsten, Stenstroem, IEEE Trans. AES 39 (2003) 760) over a
 * tree of blocks of voxels. With the samples referred to the centre c of a block, G, the sum
 *     V(v) = sum_{t, r, m} G[m, t, r] exp(+j 2 pi k_m (|v - t| - |c - t| + |v - r| - |c - r|))
 * varies slowly over antennas and frequencies, and a skeleton of few of either approximates it: the terms
 * of the rest are added to those of the skeleton with the weights of an interpolative decomposition
 * (clradar.phasors.interpolative.py). From a block to the smaller blocks in it, G is referred to their
 * centres and reduced to fewer rows, columns and frequencies; in the smallest blocks V is summed directly.
 * Rows and columns (transmitters and receivers, or the other way round) are transposed from level to
 * level, so that the sum over rows is always the first one. See tree_sums.cl. */
#ifndef CLR_KEPT
#error "CLR_KEPT (most skeleton voxels of a row, held in private memory; 0 where all voxels are summed) is missing"
#endif
#include "common/smallest_blocks.h"

/* Cycles of a plane wave from a block's centre to voxels. */
static inline realw wave_cycles(__global const float *wave, realw x, realw y, realw z) {
    return fused((realw)(wave[0]), x, fused((realw)(wave[1]), y, wave[2] * z));
}

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
 * offset, rests (n_blocks, 3), first (n_blocks, 3), place   see common/smallest_blocks.h
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

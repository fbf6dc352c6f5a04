/* The imaging operator over a tree of blocks of voxels or points: the sums of backproject_fast.cl, transposed,
 * with conjugate phasors. In the smallest blocks the capture relative to the block's centre,
 *     G[m, t, r] = sum_v rho_v exp(-j 2 pi k_m (|v - t| - |c - t| + |v - r| - |c - r|)),
 * is summed for the skeleton of antennas and frequencies alone. From blocks to the larger one around them the
 * weights of the interpolative decomposition give the frequencies, columns and rows of that one's skeleton,
 * G is referred to its centre, and the blocks in it are added in their order. */
#ifndef CLR_GROUPS
#error "CLR_GROUPS (groups of CLR_WIDTH voxels whose phasors are in private memory) is missing"
#endif
#if !defined(CLR_TILE) || CLR_TILE != 4
#error "CLR_TILE (weighted sums per pass over the rows) must be 4: sums are stored as float4"
#endif
#include "common/smallest_blocks.h"

#define FOUR_SUMS(v) (float4)(lane_sum(v[0]), lane_sum(v[1]), lane_sum(v[2]), lane_sum(v[3]))

/* The reflectivity of CLR_WIDTH voxels of a block, 0 where there is none. */
static inline void load_values(const uint n_x, const uint n_y, const uint n_z, const uint voxel,
                               const uint n_leaf, __global const int *first,
                               __global const int *place, __global const float *volume, realw *re,
                               realw *im) {
    const size_t plane = (size_t)n_z * n_y * n_x;
#if CLR_POINTS
    if (voxel + CLR_WIDTH <= n_leaf) {
        *re = LOADW(volume + first[0] + voxel);
        *im = LOADW(volume + plane + first[0] + voxel);
        return;
    }
#endif
    float values_re[CLR_WIDTH], values_im[CLR_WIDTH];
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
        const long index =
            voxel + lane < n_leaf ? leaf_index(n_x, n_y, n_z, voxel + lane, first, place) : -1;
        values_re[lane] = index >= 0 ? volume[index] : 0.0f;
        values_im[lane] = index >= 0 ? volume[plane + index] : 0.0f;
    }
#if CLR_WIDTH == 8
    *re = ((loose8 *)values_re)->v;
    *im = ((loose8 *)values_im)->v;
#else
    *re = values_re[0];
    *im = values_im[0];
#endif
}

/* The skeleton's samples of the voxels or points of the smallest blocks. Item = some frequencies of one block;
 * it goes through the voxels CLR_GROUPS x CLR_WIDTH at a time.
 *
 * Arguments as of image_of_blocks; volume is read; n_at_once frequencies per item
 * g        float (n_blocks, n_m, n_rows, 2, n_padded)  out */
__kernel void blocks_of_voxels(const uint n_voxels, const uint n_blocks, const uint n_m,
                               const uint n_rows, const uint n_columns, const uint n_padded,
                               const uint n_x, const uint n_y, const uint n_z,
                               const uint n_offsets, const uint n_at_once,
                               __global const float *volume, __global const float *offset,
                               __global const float *centres, __global const float *rests,
                               __global const int *first, __global const int *place,
                               __global const float *rows, __global const float *columns,
                               __global const float *k, __global float *g) {
    const uint m0 = (uint)get_global_id(0) * n_at_once, block = (uint)get_global_id(1);
    if (m0 >= n_m || block >= n_blocks) return;
    const uint m1 = m0 + n_at_once < n_m ? m0 + n_at_once : n_m;
    __global const int *from = first + 3 * block;
    __global const float *c = centres + 3 * block;
    const uint n_leaf = leaf_size(n_voxels, from);
    length_type row_m[CLR_LEAF * CLR_GROUPS], column_m[CLR_LEAF * CLR_GROUPS];
    realw column_re[CLR_LEAF * CLR_GROUPS], column_im[CLR_LEAF * CLR_GROUPS];
    realw value_re[CLR_GROUPS], value_im[CLR_GROUPS], row_re[CLR_GROUPS], row_im[CLR_GROUPS];
    for (uint v0 = 0; v0 < n_leaf; v0 += CLR_GROUPS * CLR_WIDTH) {
        const uint left = (n_leaf - v0 + CLR_WIDTH - 1) / CLR_WIDTH;
        const uint n = left < CLR_GROUPS ? left : CLR_GROUPS;
        for (uint i = 0; i < n; ++i) {
            const uint voxel = v0 + i * CLR_WIDTH;
            load_values(n_x, n_y, n_z, voxel, n_leaf, from, place, volume, value_re + i,
                        value_im + i);
            const offsets o = load_offsets(n_offsets, voxel, offset, rests + 3 * block, from);
            for (uint j = 0; j < n_rows; ++j)
                row_m[j * CLR_GROUPS + i] = length_from_centre(o, c, rows + 6 * j);
            for (uint j = 0; j < n_columns; ++j)
                column_m[j * CLR_GROUPS + i] = length_from_centre(o, c, columns + 6 * j);
        }
        for (uint m = m0; m < m1; ++m) {
            const float k_hi = k[m], k_lo = k[n_m + m];
            for (uint j = 0; j < n_columns; ++j)
                for (uint i = 0; i < n; ++i) {
                    const uint at = j * CLR_GROUPS + i;
                    phasor(column_m[at], k_hi, k_lo, column_re + at, column_im + at);
                }
            for (uint j = n_columns; j % CLR_TILE; ++j)
                for (uint i = 0; i < n; ++i)
                    column_re[j * CLR_GROUPS + i] = column_im[j * CLR_GROUPS + i] = 0.0f;
            __global float *out = g + ((size_t)block * n_m + m) * n_rows * 2 * n_padded;
            for (uint row = 0; row < n_rows; ++row, out += 2 * n_padded) {
                for (uint i = 0; i < n; ++i) {
                    realw cosine, sine;
                    phasor(row_m[row * CLR_GROUPS + i], k_hi, k_lo, &cosine, &sine);
                    row_re[i] = fused(value_re[i], cosine, value_im[i] * sine);
                    row_im[i] = fused(value_im[i], cosine, -(value_re[i] * sine));
                }
                for (uint j = 0; j < n_padded; j += CLR_TILE) {
                    realw re[CLR_TILE], im[CLR_TILE];
#pragma unroll
                    for (uint t = 0; t < CLR_TILE; ++t) re[t] = im[t] = 0.0f;
                    if (j < n_columns)
                        for (uint i = 0; i < n; ++i) {
                            const realw a = row_re[i], b = row_im[i];
#pragma unroll
                            for (uint t = 0; t < CLR_TILE; ++t) {
                                const realw cosine = column_re[(j + t) * CLR_GROUPS + i];
                                const realw sine = column_im[(j + t) * CLR_GROUPS + i];
                                re[t] = fused(a, cosine, fused(b, sine, re[t]));
                                im[t] = fused(b, cosine, fused(-a, sine, im[t]));
                            }
                        }
                    float4 sum_re = FOUR_SUMS(re), sum_im = FOUR_SUMS(im);
                    if (v0 > 0) {
                        sum_re += LOAD4(out + j);
                        sum_im += LOAD4(out + n_padded + j);
                    }
                    ((__global loose4 *)(out + j))->v = sum_re;
                    ((__global loose4 *)(out + n_padded + j))->v = sum_im;
                }
            }
        }
    }
}

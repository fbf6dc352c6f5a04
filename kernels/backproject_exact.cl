/* Back-projection as a brute-force sum:
 *     V(v) = sum over tx, rx, n of s[tx, rx, n] exp(+j 2 pi f_n (|v - tx| + |v - rx|) / c)
 *
 * Item = CLR_WIDTH neighbouring voxels along x. The exponential is a product of one factor per
 * antenna, so for each frequency the sum is a bilinear form between two vectors of phasors:
 * (n_tx + n_rx) sines and cosines and n_tx n_rx complex products. One call adds a block of frequencies,
 * receivers and transmitters of fixed size, whose part of the cube stays in the cache over all voxels. */
#ifndef CLR_RX_CHUNK
#error "CLR_RX_CHUNK (receivers that are held in private memory at a time) is missing"
#endif
#ifndef CLR_TX_BLOCK
#error "CLR_TX_BLOCK (transmitters that are summed side by side) is missing"
#endif

#include "common/voxel.h"

/* cube    float (n_freq, n_tx, n_rx, 2)   weighted capture; n_tx a multiple of CLR_TX_BLOCK, zero where padded
 * k_hi, k_lo  float (n_freq)              f / c, cycles per metre
 * tx      float (n_tx, 6)                 antennas, metres: x, y, z as hi, then as lo
 * rx      float (n_rx, 6)                 the same; n_rx <= CLR_RX_CHUNK on a CPU
 * axes    see common/voxel.h
 * volume  float (2, n_z, n_y, n_x_padded)    in and out: real, imaginary part */
__kernel void backproject_exact(const uint n_x_padded, const uint n_y, const uint n_z,
                                const uint first_y, const uint first_z, const uint n_axis_y,
                                const uint n_tx, const uint n_rx, const uint n_freq,
                                __global const float *cube,
                                __global const float *k_hi, __global const float *k_lo,
                                __global const float *tx, __global const float *rx,
                                __global const float *axes, __global float *volume) {
    const uint ix = (uint)get_global_id(0) * CLR_WIDTH, iy = (uint)get_global_id(1);
    const uint iz = (uint)get_global_id(2);
    if (ix >= n_x_padded || iy >= n_y || iz >= n_z) return;
    const voxels v = load_voxels(axes, n_x_padded, n_axis_y, ix, first_y + iy, first_z + iz);
    realw rx_re[CLR_RX_CHUNK], rx_im[CLR_RX_CHUNK];
    realw sum_re = 0.0f, sum_im = 0.0f;
#if CLR_WIDTH == 8
    dual rx_length[CLR_RX_CHUNK];
    for (uint r = 0; r < n_rx; ++r) rx_length[r] = distance_to(v, rx + 6 * r);
#define RX_LENGTH(r) rx_length[r]
#else
#define RX_LENGTH(r) distance_to(v, rx + 6 * (r)) /* private memory is dearer */
#endif

    for (uint n = 0; n < n_freq; ++n) {
        const wavenumber k = make_wavenumber(k_hi[n], k_lo[n]);
        for (uint r0 = 0; r0 < n_rx; r0 += CLR_RX_CHUNK) {
            const uint n_here = n_rx - r0 < CLR_RX_CHUNK ? n_rx - r0 : CLR_RX_CHUNK;
            for (uint r = 0; r < n_here; ++r)
                cos_sin_cycles(cycles(RX_LENGTH(r0 + r), k), &rx_re[r], &rx_im[r]);
            for (uint t0 = 0; t0 < n_tx; t0 += CLR_TX_BLOCK) {
                realw re[CLR_TX_BLOCK], im[CLR_TX_BLOCK];
#pragma unroll
                for (uint t = 0; t < CLR_TX_BLOCK; ++t) re[t] = im[t] = 0.0f;
                __global const float *row = cube + 2 * (((size_t)n * n_tx + t0) * n_rx + r0);
                for (uint r = 0; r < n_here; ++r) {
                    const realw b_re = rx_re[r], b_im = rx_im[r];
#pragma unroll
                    for (uint t = 0; t < CLR_TX_BLOCK; ++t) {
                        const float s_re = row[2 * ((size_t)t * n_rx + r)];
                        const float s_im = row[2 * ((size_t)t * n_rx + r) + 1];
                        re[t] = fused(b_re, (realw)(s_re), re[t]);
                        im[t] = fused(b_re, (realw)(s_im), im[t]);
                        re[t] = fused(b_im, (realw)(-s_im), re[t]);
                        im[t] = fused(b_im, (realw)(s_re), im[t]);
                    }
                }
#pragma unroll
                for (uint t = 0; t < CLR_TX_BLOCK; ++t) {
                    realw a_re, a_im;
                    cos_sin_cycles(cycles(distance_to(v, tx + 6 * (t0 + t)), k), &a_re, &a_im);
                    sum_re = fused(a_re, re[t], fused(-a_im, im[t], sum_re));
                    sum_im = fused(a_re, im[t], fused(a_im, re[t], sum_im));
                }
            }
        }
    }
    const size_t plane = (size_t)n_z * n_y * n_x_padded;
    __global float *at = volume + ((size_t)iz * n_y + iy) * n_x_padded + ix;
    STOREW(LOADW(at) + sum_re, at);
    STOREW(LOADW(at + plane) + sum_im, at + plane);
}

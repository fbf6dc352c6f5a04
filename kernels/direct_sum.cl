/* The imaging operator at points, term by term, and its adjoint:
 *     s[t, r, n] = sum_p rho_p exp(-j 2 pi f_n (|p - t| + |p - r|) / c)
 *     V(p)       = sum_{t, r, n} s[t, r, n] exp(+j 2 pi f_n (|p - t| + |p - r|) / c)
 * over the points that both antennas of a pair see. The exponential is a product of one phasor per antenna,
 * so phasors of some points and frequencies are made first, and both sums are bilinear forms in them. */
#ifndef CLR_TX_BLOCK
#error "CLR_TX_BLOCK (transmitters that are summed side by side) is missing"
#endif
#ifndef CLR_RX_BLOCK
#error "CLR_RX_BLOCK (receivers that are summed side by side) is missing"
#endif

#include "common/phase.h"

/* exp(+j 2 pi f d / c) times an amplitude. Item = CLR_WIDTH points of one antenna.
 *
 * points    float (6, n_points)                x, y, z as hi, then as lo, metres; n_points is a multiple of
 *                                              CLR_WIDTH
 * antennas  float (n_antennas, 6)              the same, metres
 * k         float (2, n_freq)                  f / c, cycles per metre as hi, then lo
 * amplitude float (2, n_points)                real, imaginary part
 * seen      float (n_antennas, n_points)       1 where the antenna sees the point, else 0
 * phasors   float (n_freq, n_padded, 2, n_points)  out: real, imaginary part; zero for the antennas that
 *                                              fill up a block */
__kernel void point_phasors(const uint n_points, const uint n_antennas, const uint n_freq,
                            const uint n_padded, __global const float *points,
                            __global const float *antennas, __global const float *k,
                            __global const float *amplitude, __global const float *seen,
                            __global float *phasors) {
    const uint point = (uint)get_global_id(0) * CLR_WIDTH, antenna = (uint)get_global_id(1);
    if (point >= n_points || antenna >= n_padded) return;
    __global float *out = phasors + (size_t)2 * antenna * n_points + point;
    const size_t step = (size_t)2 * n_padded * n_points;
    if (antenna >= n_antennas) {
        for (uint n = 0; n < n_freq; ++n, out += step) {
            STOREW((realw)(0.0f), out);
            STOREW((realw)(0.0f), out + n_points);
        }
        return;
    }
    __global const float *a = antennas + 6 * antenna, *p = points + point;
    const dual length = dual_length(
        dual_difference(LOADW(p), LOADW(p + 3 * n_points), a[0], a[3]),
        dual_difference(LOADW(p + n_points), LOADW(p + 4 * n_points), a[1], a[4]),
        dual_difference(LOADW(p + 2 * n_points), LOADW(p + 5 * n_points), a[2], a[5]));
    const realw visible = LOADW(seen + (size_t)antenna * n_points + point);
    const realw re = visible * LOADW(amplitude + point);
    const realw im = visible * LOADW(amplitude + n_points + point);
    for (uint n = 0; n < n_freq; ++n, out += step) {
        realw cosine, sine;
        cos_sin_cycles(cycles(length, make_wavenumber(k[n], k[n_freq + n])), &cosine, &sine);
        STOREW(fused(re, cosine, -(im * sine)), out);
        STOREW(fused(re, sine, im * cosine), out + n_points);
    }
}

/* Add conj(sum over points of tx rx) to the capture. Item = CLR_TX_BLOCK x CLR_RX_BLOCK pairs of one
 * frequency.
 *
 * tx, rx   float (n_freq, n_tx or n_rx, 2, n_points)  phasors; those of Tx have the conjugate of the
 *                                              reflectivity as amplitude; n_tx and n_rx are multiples of
 *                                              their blocks
 * capture  float (n_freq, n_tx, n_rx, 2)       in and out */
__kernel void sum_over_points(const uint n_points, const uint n_tx, const uint n_rx,
                              const uint n_freq, __global const float *tx,
                              __global const float *rx, __global float *capture) {
    const uint r0 = (uint)get_global_id(0) * CLR_RX_BLOCK, t0 = (uint)get_global_id(1) * CLR_TX_BLOCK;
    const uint n = (uint)get_global_id(2);
    if (r0 >= n_rx || t0 >= n_tx || n >= n_freq) return;
    realw re[CLR_TX_BLOCK][CLR_RX_BLOCK], im[CLR_TX_BLOCK][CLR_RX_BLOCK];
#pragma unroll
    for (uint t = 0; t < CLR_TX_BLOCK; ++t)
#pragma unroll
        for (uint r = 0; r < CLR_RX_BLOCK; ++r) re[t][r] = im[t][r] = 0.0f;
    __global const float *a = tx + ((size_t)n * n_tx + t0) * 2 * n_points;
    __global const float *b = rx + ((size_t)n * n_rx + r0) * 2 * n_points;
    for (uint p = 0; p < n_points; p += CLR_WIDTH) {
        realw b_re[CLR_RX_BLOCK], b_im[CLR_RX_BLOCK];
#pragma unroll
        for (uint r = 0; r < CLR_RX_BLOCK; ++r) {
            b_re[r] = LOADW(b + (size_t)2 * r * n_points + p);
            b_im[r] = LOADW(b + (size_t)(2 * r + 1) * n_points + p);
        }
#pragma unroll
        for (uint t = 0; t < CLR_TX_BLOCK; ++t) {
            const realw a_re = LOADW(a + (size_t)2 * t * n_points + p);
            const realw a_im = LOADW(a + (size_t)(2 * t + 1) * n_points + p);
#pragma unroll
            for (uint r = 0; r < CLR_RX_BLOCK; ++r) {
                re[t][r] = fused(a_re, b_re[r], fused(-a_im, b_im[r], re[t][r]));
                im[t][r] = fused(a_re, b_im[r], fused(a_im, b_re[r], im[t][r]));
            }
        }
    }
#pragma unroll
    for (uint t = 0; t < CLR_TX_BLOCK; ++t)
#pragma unroll
        for (uint r = 0; r < CLR_RX_BLOCK; ++r) {
            __global float *out = capture + 2 * (((size_t)n * n_tx + t0 + t) * n_rx + r0 + r);
            out[0] += lane_sum(re[t][r]);
            out[1] -= lane_sum(im[t][r]);
        }
}

/* The part of each frequency in V. Item = CLR_WIDTH points of one frequency.
 *
 * tx, rx   as above, amplitude 1
 * capture  float (n_freq, n_tx, n_rx, 2)
 * values   float (n_freq, 2, n_points)         out: real, imaginary part */
__kernel void sum_over_pairs(const uint n_points, const uint n_tx, const uint n_rx,
                             const uint n_freq, __global const float *tx, __global const float *rx,
                             __global const float *capture, __global float *values) {
    const uint p = (uint)get_global_id(0) * CLR_WIDTH, n = (uint)get_global_id(1);
    if (p >= n_points || n >= n_freq) return;
    realw sum_re = 0.0f, sum_im = 0.0f;
    for (uint t0 = 0; t0 < n_tx; t0 += CLR_TX_BLOCK) {
        realw re[CLR_TX_BLOCK], im[CLR_TX_BLOCK];
#pragma unroll
        for (uint t = 0; t < CLR_TX_BLOCK; ++t) re[t] = im[t] = 0.0f;
        __global const float *row = capture + 2 * ((size_t)n * n_tx + t0) * n_rx;
        __global const float *b = rx + (size_t)n * n_rx * 2 * n_points + p;
        for (uint r = 0; r < n_rx; ++r) {
            const realw b_re = LOADW(b), b_im = LOADW(b + n_points);
            b += 2 * n_points;
#pragma unroll
            for (uint t = 0; t < CLR_TX_BLOCK; ++t) {
                const float s_re = row[2 * ((size_t)t * n_rx + r)];
                const float s_im = row[2 * ((size_t)t * n_rx + r) + 1];
                re[t] = fused(b_re, (realw)(s_re), fused(b_im, (realw)(-s_im), re[t]));
                im[t] = fused(b_re, (realw)(s_im), fused(b_im, (realw)(s_re), im[t]));
            }
        }
        __global const float *a = tx + ((size_t)n * n_tx + t0) * 2 * n_points + p;
#pragma unroll
        for (uint t = 0; t < CLR_TX_BLOCK; ++t) {
            const realw a_re = LOADW(a + (size_t)2 * t * n_points);
            const realw a_im = LOADW(a + (size_t)(2 * t + 1) * n_points);
            sum_re = fused(a_re, re[t], fused(-a_im, im[t], sum_re));
            sum_im = fused(a_re, im[t], fused(a_im, re[t], sum_im));
        }
    }
    __global float *out = values + (size_t)2 * n * n_points + p;
    STOREW(sum_re, out);
    STOREW(sum_im, out + n_points);
}

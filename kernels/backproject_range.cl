/* Back-projection from range profiles:
 *     V(v) = sum over pairs of P[pair](d) exp(+j 2 pi f_c d / c),   d = |v - tx| + |v - rx|,
 * where P[pair](d) = sum_n s[pair, n] exp(+j 2 pi (f_n - f_c) d / c) is sampled over d first and then read
 * by linear interpolation. The carrier f_c at the band's centre keeps P slowly varying. Bins are counted
 * from d = 0, so no result depends on which part of the profiles is computed. */
#ifndef CLR_RX_CHUNK
#error "CLR_RX_CHUNK (most receivers per call: they are held in private memory) is missing"
#endif

#include "common/voxel.h"

/* cube      float (n_pairs, n_freq, 2)        weighted capture of these pairs
 * table     float (n_freq, 2, n_bins)         cosine and sine of 2 pi (f_n - f_c) d / c at each bin;
 *                                             n_bins is a multiple of CLR_WIDTH
 * profiles  float (n_pairs, n_bins, 2)        out */
__kernel void range_profiles(const uint n_pairs, const uint n_freq, const uint n_bins,
                             __global const float *cube, __global const float *table,
                             __global float *profiles) {
    const uint bin = (uint)get_global_id(0) * CLR_WIDTH, pair = (uint)get_global_id(1);
    if (bin >= n_bins || pair >= n_pairs) return;
    realw re = 0.0f, im = 0.0f;
    __global const float *s = cube + 2 * (size_t)pair * n_freq;
    for (uint n = 0; n < n_freq; ++n) {
        const realw cosine = LOADW(table + (size_t)2 * n * n_bins + bin);
        const realw sine = LOADW(table + (size_t)(2 * n + 1) * n_bins + bin);
        const float s_re = s[2 * n], s_im = s[2 * n + 1];
        re = fused(cosine, (realw)(s_re), fused(sine, (realw)(-s_im), re));
        im = fused(cosine, (realw)(s_im), fused(sine, (realw)(s_re), im));
    }
    __global float *out = profiles + 2 * ((size_t)pair * n_bins + bin);
#if CLR_WIDTH == 8
    STOREW((float8)(re.s0, im.s0, re.s1, im.s1, re.s2, im.s2, re.s3, im.s3), out);
    STOREW((float8)(re.s4, im.s4, re.s5, im.s5, re.s6, im.s6, re.s7, im.s7), out + 8);
#else
    out[0] = re;
    out[1] = im;
#endif
}

/* The profile at `position` (bins from d = 0, within first_bin ... first_bin + n_bins - 2), per lane. */
static inline void profile_at(__global const float *profile, const realw position,
                              const int first_bin, realw *re, realw *im) {
#if CLR_WIDTH == 8
    const int8 whole = convert_int8_rtz(position);
    const float8 f = position - convert_float8(whole);
    const int8 bin = whole - first_bin;
    /* Two neighbouring complex bins per lane. */
    const float4 q0 = LOAD4(profile + 2 * bin.s0), q1 = LOAD4(profile + 2 * bin.s1);
    const float4 q2 = LOAD4(profile + 2 * bin.s2), q3 = LOAD4(profile + 2 * bin.s3);
    const float4 q4 = LOAD4(profile + 2 * bin.s4), q5 = LOAD4(profile + 2 * bin.s5);
    const float4 q6 = LOAD4(profile + 2 * bin.s6), q7 = LOAD4(profile + 2 * bin.s7);
#ifdef CLR_CHECKED
    /* The memory checker crashes on shuffles that change the length of a vector. */
    const float8 re0 = (float8)(q0.x, q1.x, q2.x, q3.x, q4.x, q5.x, q6.x, q7.x);
    const float8 im0 = (float8)(q0.y, q1.y, q2.y, q3.y, q4.y, q5.y, q6.y, q7.y);
    const float8 re1 = (float8)(q0.z, q1.z, q2.z, q3.z, q4.z, q5.z, q6.z, q7.z);
    const float8 im1 = (float8)(q0.w, q1.w, q2.w, q3.w, q4.w, q5.w, q6.w, q7.w);
#else
    /* Lanes 0..3 and 4..7 are transposed side by side, in steps of two sources each, which compilers
     * turn into single shuffles. */
    const float8 a = (float8)(q0, q4), b = (float8)(q1, q5);
    const float8 c = (float8)(q2, q6), d = (float8)(q3, q7);
    const float8 ab0 = (float8)(a.s0, b.s0, a.s1, b.s1, a.s4, b.s4, a.s5, b.s5);
    const float8 cd0 = (float8)(c.s0, d.s0, c.s1, d.s1, c.s4, d.s4, c.s5, d.s5);
    const float8 ab1 = (float8)(a.s2, b.s2, a.s3, b.s3, a.s6, b.s6, a.s7, b.s7);
    const float8 cd1 = (float8)(c.s2, d.s2, c.s3, d.s3, c.s6, d.s6, c.s7, d.s7);
    const float8 re0 = (float8)(ab0.s01, cd0.s01, ab0.s45, cd0.s45);
    const float8 im0 = (float8)(ab0.s23, cd0.s23, ab0.s67, cd0.s67);
    const float8 re1 = (float8)(ab1.s01, cd1.s01, ab1.s45, cd1.s45);
    const float8 im1 = (float8)(ab1.s23, cd1.s23, ab1.s67, cd1.s67);
#endif
    *re = fused(f, re1 - re0, re0);
    *im = fused(f, im1 - im0, im0);
#else
    const int whole = convert_int_rtz(position);
    const float f = position - (float)whole;
    const int bin = whole - first_bin;
    const float4 q = LOAD4(profile + 2 * bin);
    *re = fused(f, q.z - q.x, q.x);
    *im = fused(f, q.w - q.y, q.y);
#endif
}

/* Item = CLR_WIDTH neighbouring voxels along x. The carrier is a product of one factor per antenna. One
 * call adds some transmitters to the sum of the calls before it, so the split changes nothing.
 *
 * profiles  float (n_tx, n_rx, n_bins, 2)    
 * bins_per_m  1 / step                        k_hi, k_lo  f_c / c, cycles per metre
 * tx        float (n_tx, 6)                   antennas, metres: x, y, z as hi, then as lo
 * rx        float (n_rx, 6)
 * axes      see common/voxel.h
 * volume    float (2, n_z, n_y, n_x_padded)   in and out: real, imaginary part */
__kernel void backproject_range(const uint n_x_padded, const uint n_y, const uint n_z,
                                const uint first_y, const uint first_z, const uint n_axis_y,
                                const uint n_tx, const uint n_rx, const uint n_bins,
                                const int first_bin, const float bins_per_m, const float k_hi,
                                const float k_lo, __global const float *profiles,
                                __global const float *tx, __global const float *rx,
                                __global const float *axes, __global float *volume) {
    const uint ix = (uint)get_global_id(0) * CLR_WIDTH, iy = (uint)get_global_id(1);
    const uint iz = (uint)get_global_id(2);
    if (ix >= n_x_padded || iy >= n_y || iz >= n_z) return;
    const voxels v = load_voxels(axes, n_x_padded, n_axis_y, ix, first_y + iy, first_z + iz);
    const size_t plane = (size_t)n_z * n_y * n_x_padded;
    __global float *at = volume + ((size_t)iz * n_y + iy) * n_x_padded + ix;
    const wavenumber k = make_wavenumber(k_hi, k_lo);
    realw rx_bins[CLR_RX_CHUNK], rx_re[CLR_RX_CHUNK], rx_im[CLR_RX_CHUNK];
    realw sum_re = LOADW(at), sum_im = LOADW(at + plane);

    for (uint r0 = 0; r0 < n_rx; r0 += CLR_RX_CHUNK) {
        const uint n_here = n_rx - r0 < CLR_RX_CHUNK ? n_rx - r0 : CLR_RX_CHUNK;
        for (uint r = 0; r < n_here; ++r) {
            const dual length = distance_to(v, rx + 6 * (r0 + r));
            rx_bins[r] = length.hi * bins_per_m;
            cos_sin_cycles(cycles(length, k), &rx_re[r], &rx_im[r]);
        }
        for (uint t = 0; t < n_tx; ++t) {
            const dual length = distance_to(v, tx + 6 * t);
            const realw start = length.hi * bins_per_m;
            __global const float *profile = profiles + 2 * ((size_t)t * n_rx + r0) * n_bins;
            realw re = 0.0f, im = 0.0f;
            for (uint r = 0; r < n_here; ++r) {
                realw p_re, p_im;
                profile_at(profile, start + rx_bins[r], first_bin, &p_re, &p_im);
                re = fused(p_re, rx_re[r], fused(-p_im, rx_im[r], re));
                im = fused(p_re, rx_im[r], fused(p_im, rx_re[r], im));
                profile += 2 * n_bins;
            }
            realw a_re, a_im;
            cos_sin_cycles(cycles(length, k), &a_re, &a_im);
            sum_re = fused(a_re, re, fused(-a_im, im, sum_re));
            sum_im = fused(a_re, im, fused(a_im, re, sum_im));
        }
    }
    STOREW(sum_re, at);
    STOREW(sum_im, at + plane);
}

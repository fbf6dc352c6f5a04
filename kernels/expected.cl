/* Expected receptions: in place of random outgoing directions, the probability P of each sample, Tx and Rx that
 * the outgoing ray enters the Rx sphere (common/lobe.h).
 *
 * Four steps for a tile of samples. Directions to the receivers; lobes of the transmitters; P for every pair and
 * sample, item = one Tx and CLR_WIDTH Rx, which goes through the samples; then the paths of each pair in the order
 * of samples, where the host says, from the counts of the third step, where they go. So the paths need no sort, and
 * no result depends on the tiling. */
#ifndef CLR_SPREADING
#error "CLR_SPREADING (0: amplitude 1, 1: 1 / (R1 R2) and antenna patterns) is missing"
#endif

#include "common/lobe.h"

#define RX_FIELDS 7 /* unit vector to the Rx (3), sine of its disc or 0, leg hi, leg lo, weight */
#define TX_FIELDS 16 /* see lobes.cl */

/* Below this the outgoing ray is t_m: the lobe is narrower than 0.3 micrometres at 0.3 m. */
#define LEAST_ALPHA 0x1p-20f

/* P below this is rounding. */
#define LEAST_SHARE 0x1p-24f

/* antenna   float (6, n_padded)  x, y, z as hi, then as lo, metres
 * visible   uchar (n_samples, n_groups)
 * direction float (n_samples, RX_FIELDS, n_padded)  out */
__kernel void receiver_discs(const uint n_samples, const uint n_rx, const uint n_padded,
                             const float radius, const float pattern_exponent,
                             __global const float *antenna, __global const float *point,
                             __global const uchar *visible, __global float *direction) {
    const uint block = (uint)get_global_id(0), i = (uint)get_global_id(1);
    if (i >= n_samples || block * CLR_WIDTH >= n_padded) return;
    const uint first = block * CLR_WIDTH;
    const float3 p = load3(point + 3 * (size_t)i);
    __global const float *at = antenna + first;
    const dual x = dual_difference(LOADW(at), LOADW(at + 3 * n_padded), (realw)(p.x), (realw)(0.0f));
    const dual y = dual_difference(LOADW(at + n_padded), LOADW(at + 4 * n_padded), (realw)(p.y),
                                   (realw)(0.0f));
    const dual z = dual_difference(LOADW(at + 2 * n_padded), LOADW(at + 5 * n_padded),
                                   (realw)(p.z), (realw)(0.0f));
    const dual leg = dual_length(x, y, z);
    const realw inverse = 1.0f / greater(leg.hi, (realw)(1e-20f));
    const uint bits = visible[(size_t)i * (n_padded / 8) + first / 8] >> (first % 8);
#if CLR_WIDTH == 8
    const int8 lane_bit = (int8)(1, 2, 4, 8, 16, 32, 64, 128);
#else
    const int lane_bit = 1;
#endif
    const intw seen = ((intw)((int)bits) & lane_bit) != 0;
    const intw there = (LANE_INDEX + (float)first) < (float)n_rx;
    /* 2 marks a sample inside the sphere. */
    const realw sine = leg.hi > radius ? radius * inverse : (realw)(2.0f);
    realw weight = (realw)(1.0f);
#if CLR_SPREADING
    weight = inverse;
    if (pattern_exponent > 0.0f) {
        const realw back = -z.hi * inverse;
        weight *= back > 0.0f ? pow(back, (realw)(pattern_exponent)) : (realw)(0.0f);
    }
#endif
    __global float *row = direction + (size_t)i * RX_FIELDS * n_padded + first;
    STOREW(x.hi * inverse, row);
    STOREW(y.hi * inverse, row + n_padded);
    STOREW(z.hi * inverse, row + 2 * n_padded);
    STOREW(choose((seen & there) | (sine > 1.0f & there), sine, (realw)(0.0f)), row + 3 * n_padded);
    STOREW(leg.hi, row + 4 * n_padded);
    STOREW(leg.lo, row + 5 * n_padded);
    STOREW(weight, row + 6 * n_padded);
}

/* direction float (n_samples, RX_FIELDS, n_padded)
 * tx_lobe   float (n_samples, n_tx, TX_FIELDS)
 * alpha     float (n_samples)
 * rule      float (CLR_COARSE + CLR_FINE, 2)   nodes and weights, see common/lobe.h
 * share     float (n_tx, n_samples, n_padded)  out: P
 * count     float (n_tx, n_padded)             out: samples with a P of each pair; below 2^24, so exact */
__kernel void expected_shares(const uint n_samples, const uint n_tx, const uint n_padded,
                              __global const float *direction, __global const float *tx_lobe,
                              __global const float *alpha, __global const float *rule,
                              __global float *share, __global float *count) {
    const uint block = (uint)get_global_id(0), tx = (uint)get_global_id(1);
    if (block * CLR_WIDTH >= n_padded || tx >= n_tx) return;
    const uint first = block * CLR_WIDTH;
    realw counted = (realw)(0.0f);
    for (uint i = 0; i < n_samples; ++i) {
        __global const float *t = tx_lobe + ((size_t)i * n_tx + tx) * TX_FIELDS;
        __global float *out = share + ((size_t)tx * n_samples + i) * n_padded + first;
        if (t[13] == 0.0f) {
            STOREW((realw)(0.0f), out);
            continue;
        }
        __global const float *row = direction + (size_t)i * RX_FIELDS * n_padded + first;
        const realw x = LOADW(row), y = LOADW(row + n_padded), z = LOADW(row + 2 * n_padded);
        const float3 axis = load3(t), side = load3(t + 3), third = cross3(axis, side);
        lobe l;
        l.alpha = alpha[i];
        l.k = 1.0f - l.alpha;
        l.n_z = t[6];
        l.n_x = t[7];
        l.g_x = t[8];
        l.g_y = t[9];
        l.g_z = t[10];
        const float beyond_half = l.k - l.alpha;
        l.sheets = beyond_half > 0.0f ? 2 : 1;
        l.edge = beyond_half > 0.0f ? l.alpha / l.k : 1.0f;
        l.edge_cos = beyond_half > 0.0f ? sqrt(beyond_half) / l.k : 0.0f;
        disc d;
        d.sine = LOADW(row + 3 * n_padded);
        d.inside = d.sine > 1.0f;
        intw wanted = d.sine > 0.0f;
        d.sine = choose(d.inside, (realw)(1.0f), d.sine);
        d.cosine = sqrt((1.0f - d.sine) * (1.0f + d.sine));
        d.z = x * axis.x + y * axis.y + z * axis.z;
        const realw off_x = x * side.x + y * side.y + z * side.z;
        const realw off_y = x * third.x + y * third.y + z * third.z;
        d.rho = sqrt(off_x * off_x + off_y * off_y);
        realw p;
        if (l.alpha < LEAST_ALPHA) {
            const intw hit = ((d.rho < d.sine) & (d.z > 0.0f)) | d.inside;
            p = choose(hit & wanted & (intw)(l.g_z > 0.0f ? -1 : 0), (realw)(1.0f), (realw)(0.0f));
        } else {
            /* Out of the lobe's reach, or below the face. */
            const realw height = l.g_x * off_x + l.g_y * off_y + l.g_z * d.z;
            if (l.sheets == 2)
                wanted &= (d.z > l.edge_cos * d.cosine - l.edge * d.sine - 1e-5f) | d.inside;
            wanted &= (height > -d.sine) | d.inside;
            if (!ANYW(wanted)) {
                STOREW((realw)(0.0f), out);
                continue;
            }
            const realw inverse = 1.0f / greater(d.rho, (realw)(1e-20f));
            const intw centred = d.rho < 1e-20f;
            d.cos_psi = choose(centred, (realw)(1.0f), off_x * inverse);
            d.sin_psi = choose(centred, (realw)(0.0f), off_y * inverse);
            d.around = (d.rho <= d.sine) | d.inside;
            d.ratio = choose(d.around, (realw)(1.0f), d.sine * inverse);
            const intw clipped = wanted & ((height < d.sine) | d.inside);
            p = disc_share(l, d, wanted, clipped, rule);
            p = p > LEAST_SHARE ? p : (realw)(0.0f);
        }
        STOREW(p, out);
        counted += choose(p > 0.0f, (realw)(1.0f), (realw)(0.0f));
    }
    STOREW(counted, count + (size_t)tx * n_padded + first);
}

/* start  uint (n_tx * n_rx + 1)  first path of each pair
 * path   float (n_paths, 4)      out: length hi, length lo, amplitude, unused; metres */
__kernel void expected_paths(const uint n_samples, const uint n_tx, const uint n_rx,
                             const uint n_padded, const float rays,
                             __global const float *direction, __global const float *tx_lobe,
                             __global const float *share, __global const uint *start,
                             __global float *path) {
    const uint block = (uint)get_global_id(0), tx = (uint)get_global_id(1);
    if (block * CLR_WIDTH >= n_padded || tx >= n_tx) return;
    const uint first = block * CLR_WIDTH;
    uint next[CLR_WIDTH];
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
        const uint rx = first + lane;
        next[lane] = start[tx * n_rx + (rx < n_rx ? rx : n_rx - 1)];
    }
    for (uint i = 0; i < n_samples; ++i) {
        __global const float *of = share + ((size_t)tx * n_samples + i) * n_padded + first;
        const realw p = LOADW(of);
        if (!ANYW(p > 0.0f)) continue;
        __global const float *t = tx_lobe + ((size_t)i * n_tx + tx) * TX_FIELDS;
        __global const float *row = direction + (size_t)i * RX_FIELDS * n_padded + first;
        dual there, back;
        there.hi = (realw)(t[11]);
        there.lo = (realw)(t[12]);
        back.hi = LOADW(row + 4 * n_padded);
        back.lo = LOADW(row + 5 * n_padded);
        const dual length = dual_add(there, back);
        const realw amplitude = p * LOADW(row + 6 * n_padded) * (rays * t[13]);
#if CLR_WIDTH == 8
#define EMIT(n) EMIT_ONE(n, p.s##n, length.hi.s##n, length.lo.s##n, amplitude.s##n)
#else
#define EMIT(n) EMIT_ONE(n, p, length.hi, length.lo, amplitude)
#endif
#define EMIT_ONE(n, p, hi, lo, a)                          \
    if (p > 0.0f) {                                        \
        __global float *to = path + 4 * (size_t)next[n]++; \
        to[0] = hi;                                        \
        to[1] = lo;                                        \
        to[2] = a;                                         \
        to[3] = 0.0f;                                      \
    }
        EMIT(0)
#if CLR_WIDTH == 8
        EMIT(1)
        EMIT(2)
        EMIT(3)
        EMIT(4)
        EMIT(5)
        EMIT(6)
        EMIT(7)
#endif
    }
}

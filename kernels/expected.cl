/* Expected receptions: in place of random outgoing directions, the probability P of each sample, Tx and Rx that
 * the outgoing ray enters the Rx sphere (common/lobe.h).
 *
 * Four steps for a tile of samples: directions to the receivers; lobes of the transmitters; P for every
 * pair and sample, item = one Tx and CLR_WIDTH Rx, which goes through the samples; and the paths of each pair in the
 * order of samples. The host sums the counts of the third step to the first path of each pair. So the paths need no
 * sort, and no result depends on the tiling. */
#if !defined(CLR_SPREADING) || !defined(CLR_GROUP)
#error "CLR_SPREADING (0: amplitude 1, 1: 1 / (R1 R2) and patterns), CLR_GROUP (antennas) are missing"
#endif
#if !defined(CLR_RX_FIELDS) || !defined(CLR_TX_FIELDS)
#error "CLR_RX_FIELDS, CLR_TX_FIELDS (numbers of a sample and Rx or Tx) are missing"
#endif

#include "common/lobe.h"

/* Below this the outgoing ray is t_m: the lobe is narrower than 0.3 micrometres at 0.3 m. */
#define LEAST_ALPHA 0x1p-20f

/* P below this is rounding. */
#define LEAST_PROBABILITY 0x1p-24f

/* antenna   float (6, n_padded)  x, y, z as hi, then as lo, metres
 * visible   uchar (n_samples, n_groups)
 * direction float (n_samples, CLR_RX_FIELDS, n_padded)  out: unit vector to the Rx (3), sine of its disc
 *           or 0 where it is hidden, path segment as hi and lo, metres, weight */
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
    const dual segment = dual_length(x, y, z);
    const realw inverse = 1.0f / greater(segment.hi, (realw)(1e-20f));
    const uint bits = visible[(size_t)i * (n_padded / CLR_GROUP) + first / CLR_GROUP] >> (first % CLR_GROUP);
    const intw visible_lanes = (((intw)((int)bits) >> TO_INTW(LANE_INDEX)) & 1) != 0;
    const intw there = (LANE_INDEX + (float)first) < (float)n_rx;
    /* 2 marks a sample inside the sphere. */
    const realw sine = segment.hi > radius ? radius * inverse : (realw)(2.0f);
    realw weight = (realw)(1.0f);
#if CLR_SPREADING
    weight = inverse;
    if (pattern_exponent > 0.0f) {
        const realw back = -z.hi * inverse;
        weight *= back > 0.0f ? pow(back, (realw)(pattern_exponent)) : (realw)(0.0f);
    }
#endif
    __global float *row = direction + (size_t)i * CLR_RX_FIELDS * n_padded + first;
    STOREW(x.hi * inverse, row);
    STOREW(y.hi * inverse, row + n_padded);
    STOREW(z.hi * inverse, row + 2 * n_padded);
    STOREW(choose((visible_lanes & there) | ((sine > 1.0f) & there), sine, (realw)(0.0f)), row + 3 * n_padded);
    STOREW(segment.hi, row + 4 * n_padded);
    STOREW(segment.lo, row + 5 * n_padded);
    STOREW(weight, row + 6 * n_padded);
}

/* The lobe of outgoing directions of each sample and Tx: its axis t_m, and the normals in a frame about it. Item = one
 * sample and one Tx.
 *
 * antenna    float (n_tx, 6)         x, y, z as hi, then as lo, metres
 * point, shading, geometric  float (n_samples, 3)
 * visible    uchar (n_samples, n_groups)
 * tx_lobe    float (n_samples, n_tx, CLR_TX_FIELDS)  out:
 *     [0..2] t_m   [3..5] x axis of its frame: the normal lies in the plane of t_m and x
 *     [6] n_z, [7] n_x  the normal, facing the ray   [8..10] the face's normal, facing it
 *     [11] |Tx p| hi  [12] lo, metres  [13] weight: 0 where the Tx is hidden   [14, 15] unused */
__kernel void tx_lobes(const uint n_samples, const uint n_tx, const uint n_groups,
                       const float pattern_exponent, __global const float *antenna,
                       __global const float *point, __global const float *shading,
                       __global const float *geometric, __global const uchar *visible,
                       __global float *tx_lobe) {
    const uint tx = (uint)get_global_id(0), i = (uint)get_global_id(1);
    if (i >= n_samples || tx >= n_tx) return;
    __global float *out = tx_lobe + ((size_t)i * n_tx + tx) * CLR_TX_FIELDS;
    for (int k = 0; k < CLR_TX_FIELDS; ++k) out[k] = 0.0f;
    if (!(visible[(size_t)i * n_groups + tx / CLR_GROUP] & (1u << (tx % CLR_GROUP)))) return;
    const float3 p = load3(point + 3 * (size_t)i);
    __global const float *a = antenna + 6 * (size_t)tx;
    const realw zero = (realw)(0.0f);
    const dual x = dual_difference((realw)(p.x), zero, (realw)(a[0]), (realw)(a[3]));
    const dual y = dual_difference((realw)(p.y), zero, (realw)(a[1]), (realw)(a[4]));
    const dual z = dual_difference((realw)(p.z), zero, (realw)(a[2]), (realw)(a[5]));
    const dual segment = dual_length(x, y, z);
    const float length = FIRSTW(segment.hi);
    const float3 t_i = (float3)(FIRSTW(x.hi), FIRSTW(y.hi), FIRSTW(z.hi)) / length;
    float3 n = load3(shading + 3 * (size_t)i), face = load3(geometric + 3 * (size_t)i);
    if (dot3(n, t_i) > 0.0f) n = -n;
    if (dot3(face, t_i) > 0.0f) face = -face;
    const float n_z = -dot3(n, t_i);
    const float3 t_m = unit(t_i + 2.0f * n_z * n);

    /* At normal incidence any x axis will do. */
    const float3 across = n - n_z * t_m;
    const float3 other = absolute(t_m.x) < 0.5f ? (float3)(1.0f, 0.0f, 0.0f) : (float3)(0.0f, 1.0f, 0.0f);
    const float n_x = length3(across);
    const float3 rough = n_x > 1e-6f ? across / n_x : other;
    const float3 side = unit(rough - dot3(rough, t_m) * t_m);
    store3(t_m, out);
    store3(side, out + 3);
    out[6] = n_z;
    out[7] = dot3(n, side);
    out[8] = dot3(face, side);
    out[9] = dot3(face, cross3(t_m, side));
    out[10] = dot3(face, t_m);
    out[11] = length;
    out[12] = FIRSTW(segment.lo);
    float weight = 1.0f;
#if CLR_SPREADING
    weight = 1.0f / length;
    if (pattern_exponent > 0.0f) {
        const float leaving = FIRSTW(z.hi) / length;
        weight *= leaving > 0.0f ? pow(leaving, pattern_exponent) : 0.0f;
    }
#endif
    out[13] = weight;
}

static inline void set_alpha(lobe *l, realw alpha) {
    l->alpha = alpha;
    l->k = 1.0f - alpha;
    const realw difference = l->k - alpha, k = greater(l->k, (realw)(0.5f));
    l->two = difference > 0.0f;
    l->any_two = ANYW(l->two);
    const realw square = l->two ? difference : (realw)(0.0f);
    l->edge = choose(l->two, alpha / k, (realw)(1.0f));
    l->edge_cos = sqrt(square) / k;
}

/* The disc from its centre in the lobe's frame, and the sine of its half angle. */
static inline disc make_disc(realw x, realw y, realw z, realw sine) {
    disc d;
    d.inside = sine > 1.0f;
    d.sine = choose(d.inside, (realw)(1.0f), sine);
    d.cosine = sqrt((1.0f - d.sine) * (1.0f + d.sine));
    d.z = z;
    d.rho = sqrt(x * x + y * y);
    const realw inverse = 1.0f / greater(d.rho, (realw)(1e-20f));
    const intw centred = d.rho < 1e-20f;
    d.cos_psi = choose(centred, (realw)(1.0f), x * inverse);
    d.sin_psi = choose(centred, (realw)(0.0f), y * inverse);
    d.around = (d.rho <= d.sine) | d.inside;
    d.ratio = choose(d.around, (realw)(1.0f), d.sine * inverse);
    return d;
}

/* Lobe and disc from fields of a sample: [0..10] of tx_lobes, [11..14] of receiver_discs, [15] alpha. Returns the
 * height of the disc's centre above the face. */
static inline realw lobe_and_disc(const realw *field, lobe *l, disc *d) {
    const realw ax = field[0], ay = field[1], az = field[2];
    const realw sx = field[3], sy = field[4], sz = field[5];
    const realw ux = field[11], uy = field[12], uz = field[13];
    set_alpha(l, field[15]);
    l->n_z = field[6];
    l->n_x = field[7];
    l->g_x = field[8];
    l->g_y = field[9];
    l->g_z = field[10];
    const realw bx = ay * sz - az * sy, by = az * sx - ax * sz, bz = ax * sy - ay * sx;
    const realw x = ux * sx + uy * sy + uz * sz;
    const realw y = ux * bx + uy * by + uz * bz;
    const realw z = ux * ax + uy * ay + uz * az;
    *d = make_disc(x, y, z, field[14]);
    return l->g_x * x + l->g_y * y + l->g_z * z;
}

/* direction float (n_samples, CLR_RX_FIELDS, n_padded)
 * tx_lobe   float (n_samples, n_tx, CLR_TX_FIELDS)
 * alpha     float (n_samples)
 * rule      float, see common/lobe.h
 * probability     float (n_tx, n_samples, n_padded)  out: P
 * pending   uint (n_tx, n_padded * n_samples)  work space, each item's own part: discs to be integrated by slices
 * count     float (n_tx, n_padded)             out: samples with a P of each pair; below 2^24, so exact */
__kernel void reception_probabilities(const uint n_samples, const uint n_tx, const uint n_padded,
                              __global const float *direction, __global const float *tx_lobe,
                              __global const float *alpha, __global const float *rule,
                              __global float *probability, __global uint *pending,
                              __global float *count) {
    const uint block = (uint)get_global_id(0), tx = (uint)get_global_id(1);
    if (block * CLR_WIDTH >= n_padded || tx >= n_tx) return;
    const uint first = block * CLR_WIDTH;
    const size_t tx_row = (size_t)n_tx * CLR_TX_FIELDS, rx_row = (size_t)CLR_RX_FIELDS * n_padded;
    __global const float *lobes = tx_lobe + (size_t)tx * CLR_TX_FIELDS;
    __global const float *rx = direction + first;
    __global float *out = probability + (size_t)tx * n_samples * n_padded + first;
    __global uint *left = pending + ((size_t)tx * n_padded + first) * n_samples;
    uint waiting = 0;

    for (uint i = 0; i < n_samples; ++i) {
        __global const float *t = lobes + i * tx_row, *r = rx + i * rx_row;
        realw p = (realw)(0.0f);
        if (t[13] != 0.0f) {
            realw field[16];
#pragma unroll
            for (int k = 0; k < 11; ++k) field[k] = (realw)(t[k]);
#pragma unroll
            for (int k = 0; k < 4; ++k) field[11 + k] = LOADW(r + k * n_padded);
            field[15] = (realw)(alpha[i]);
            lobe l;
            disc d;
            const realw height = lobe_and_disc(field, &l, &d);
            intw wanted = field[14] > 0.0f;
            if (alpha[i] < LEAST_ALPHA) {
                const intw hit = ((d.rho < d.sine) & (d.z > 0.0f)) | d.inside;
                p = choose(hit & wanted & (l.g_z > 0.0f), (realw)(1.0f), p);
            } else {
                /* Not out of the lobe's reach, nor below the face. */
                const intw near = (d.z > l.edge_cos * d.cosine - l.edge * d.sine - 1e-5f) | !l.two;
                wanted &= ((height > -d.sine) & near) | d.inside;
                if (ANYW(wanted)) {
                    const intw smooth = wanted & is_smooth(l, d, height);
                    const intw rest = wanted & !smooth;
                    if (ANYW(smooth)) p = choose(smooth, smooth_probability(l, d), p);
                    if (ANYW(rest)) {
#pragma unroll
                        for (uint lane = 0; lane < CLR_WIDTH; ++lane)
                            if (INT_LANE(rest, lane)) left[waiting++] = i * CLR_WIDTH + lane;
                    }
                }
            }
        }
        STOREW(p, out + (size_t)i * n_padded);
    }

    /* The remaining discs in full vectors, the last one filled up with copies of its first. */
    for (uint at = 0; at < waiting; at += CLR_WIDTH) {
        realw field[16];
        for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
            const uint which = left[at + lane < waiting ? at + lane : at];
            const uint i = which / CLR_WIDTH;
            __global const float *t = lobes + i * tx_row, *r = rx + i * rx_row + which % CLR_WIDTH;
            float *column = (float *)field + lane;
            for (int k = 0; k < 11; ++k) column[k * CLR_WIDTH] = t[k];
            for (int k = 0; k < 4; ++k) column[(11 + k) * CLR_WIDTH] = r[k * n_padded];
            column[15 * CLR_WIDTH] = alpha[i];
        }
        lobe l;
        disc d;
        const realw height = lobe_and_disc(field, &l, &d);
        const realw p = sliced_probability(l, d, (height < d.sine) | d.inside, rule);
        for (uint lane = 0; lane < CLR_WIDTH && at + lane < waiting; ++lane) {
            const uint which = left[at + lane];
            out[(size_t)(which / CLR_WIDTH) * n_padded + which % CLR_WIDTH] = LANE(p, lane);
        }
    }

    realw counted = (realw)(0.0f);
    for (uint i = 0; i < n_samples; ++i) {
        const realw p = LOADW(out + (size_t)i * n_padded);
        counted += choose(p > LEAST_PROBABILITY, (realw)(1.0f), (realw)(0.0f));
    }
    STOREW(counted, count + (size_t)tx * n_padded + first);
}

/* start  uint (n_tx * n_rx + 1)  first path of each pair
 * length     float (n_paths, 2)  out: hi and lo, metres
 * amplitude  float (n_paths)     out */
__kernel void expected_paths(const uint n_samples, const uint n_tx, const uint n_rx,
                             const uint n_padded, const float rays,
                             __global const float *direction, __global const float *tx_lobe,
                             __global const float *probability, __global const uint *start,
                             __global float *length, __global float *amplitude) {
    const uint block = (uint)get_global_id(0), tx = (uint)get_global_id(1);
    if (block * CLR_WIDTH >= n_padded || tx >= n_tx) return;
    const uint first = block * CLR_WIDTH;
    uint next[CLR_WIDTH];
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
        const uint rx = first + lane;
        next[lane] = start[tx * n_rx + (rx < n_rx ? rx : n_rx - 1)];
    }
    for (uint i = 0; i < n_samples; ++i) {
        __global const float *of = probability + ((size_t)tx * n_samples + i) * n_padded + first;
        const realw p = LOADW(of);
        if (!ANYW(p > LEAST_PROBABILITY)) continue;
        __global const float *t = tx_lobe + ((size_t)i * n_tx + tx) * CLR_TX_FIELDS;
        __global const float *row = direction + (size_t)i * CLR_RX_FIELDS * n_padded + first;
        dual there, back;
        there.hi = (realw)(t[11]);
        there.lo = (realw)(t[12]);
        back.hi = LOADW(row + 4 * n_padded);
        back.lo = LOADW(row + 5 * n_padded);
        const dual d = dual_add(there, back);
        const realw a = p * LOADW(row + 6 * n_padded) * (rays * t[13]);
#pragma unroll
        for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
            if (!(LANE(p, lane) > LEAST_PROBABILITY)) continue;
            const size_t at = next[lane]++;
            length[2 * at] = LANE(d.hi, lane);
            length[2 * at + 1] = LANE(d.lo, lane);
            amplitude[at] = LANE(a, lane);
        }
    }
}

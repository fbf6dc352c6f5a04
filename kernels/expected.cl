/* Expected receptions: in place of random outgoing directions, the probability P of each sample, Tx and Rx that
 * the outgoing ray enters the Rx sphere (common/lobe.h).
 *
 * Steps for a tile of samples: directions to the receivers; lobes of the transmitters; P for every pair and sample; how
 * many there are of each pair; and the paths of each pair in the order of samples. Items of the last three are one Tx
 * and CLR_WIDTH Rx, and go through `share` samples, which are one part. The host sums the counts to the first path of
 * each part of each pair. So the paths need no sort, and no result depends on the tiling.
 *
 * Where the density on a disc is not smooth P takes many times as long. An item on a CPU lists these discs, then takes
 * them in full vectors, and counts; on a GPU all items share a list, which is a launch of its own. Those that take most
 * slices are listed from the end. */
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

/* Of the half angle of a disc; a sine of 2 marks a sample inside its sphere. */
static inline realw cosine_of(const realw sine) {
    const realw within = lesser(sine, (realw)(1.0f));
    return square_root((1.0f - within) * (1.0f + within));
}

static inline void set_alpha(lobe *l, realw alpha) {
    l->alpha = alpha;
    l->k = 1.0f - alpha;
    const realw difference = l->k - alpha, k = greater(l->k, (realw)(0.5f));
    l->two = difference > 0.0f;
    l->any_two = ANYW(l->two);
    const realw square = l->two ? difference : (realw)(0.0f);
    l->edge = choose(l->two, alpha / k, (realw)(1.0f));
    l->edge_cos = square_root(square) / k;
}

/* antenna   float (6, n_padded)  x, y, z as hi, then as lo, metres
 * visible   uchar (n_samples, n_groups)
 * direction float (n_samples, CLR_RX_FIELDS, n_padded)  out: unit vector to the Rx (3), sine of its disc
 *           or 0 where it is hidden, path segment as hi and lo, metres, weight, cosine of its disc */
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
    const realw seen = choose((visible_lanes & there) | ((sine > 1.0f) & there), sine, (realw)(0.0f));
    STOREW(seen, row + 3 * n_padded);
    STOREW(segment.hi, row + 4 * n_padded);
    STOREW(segment.lo, row + 5 * n_padded);
    STOREW(weight, row + 6 * n_padded);
    STOREW(cosine_of(seen), row + 7 * n_padded);
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
 *     [11] |Tx p| hi  [12] lo, metres  [13] weight: 0 where the Tx is hidden
 *     [14] sine, [15] cosine of the lobe's edge   [16..18] y axis of its frame   [19] unused
 * n_listed   uint (2)  out: 0 */
__kernel void tx_lobes(const uint n_samples, const uint n_tx, const uint n_groups,
                       const float pattern_exponent, __global const float *antenna,
                       __global const float *point, __global const float *shading,
                       __global const float *geometric, __global const float *alpha,
                       __global const uchar *visible, __global float *tx_lobe,
                       __global uint *n_listed) {
    const uint tx = (uint)get_global_id(0), i = (uint)get_global_id(1);
    if (tx == 0 && i == 0) n_listed[0] = n_listed[1] = 0;
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
    if (dot3(face, t_i) > 0.0f) face = -face;
    if (dot3(n, face) < 0.0f) n = -n;
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
    const float3 up = cross3(t_m, side);
    out[8] = dot3(face, side);
    out[9] = dot3(face, up);
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
    lobe l;
    set_alpha(&l, (realw)(alpha[i]));
    out[14] = FIRSTW(l.edge);
    out[15] = FIRSTW(l.edge_cos);
    store3(up, out + 16);
}

/* The disc of a receiver from its centre in the lobe's frame, sine and cosine as of receiver_discs. */
static inline disc make_disc(realw x, realw y, realw z, realw sine, realw cosine) {
    disc d;
    d.inside = sine > 1.0f;
    d.sine = choose(d.inside, (realw)(1.0f), sine);
    d.cosine = cosine;
    d.z = z;
    d.rho = square_root(x * x + y * y);
    const realw inverse = 1.0f / greater(d.rho, (realw)(1e-20f));
    const intw centred = d.rho < 1e-20f;
    d.cos_psi = choose(centred, (realw)(1.0f), x * inverse);
    d.sin_psi = choose(centred, (realw)(0.0f), y * inverse);
    d.around = (d.rho <= d.sine) | d.inside;
    d.ratio = choose(d.around, (realw)(1.0f), d.sine * inverse);
    return d;
}

/* Sum of products with the three numbers from `at` on of a Tx, which lanes share. */
static inline realw shared_product(__global const float *at, realw x, realw y, realw z) {
    return x * at[0] + y * at[1] + z * at[2];
}

/* Where a pair's numbers are, of item `block` and one part: */
#define ITEM_OF_PAIRS                                                                              \
    const uint block = (uint)get_global_id(0), tx = (uint)get_global_id(1);                        \
    const uint part = (uint)get_global_id(2), begin = part * share, first = block * CLR_WIDTH;     \
    if (first >= n_padded || tx >= n_tx || begin >= n_samples) return;                             \
    const uint end = n_samples - begin < share ? n_samples : begin + share;

/* P of CLR_WIDTH of the listed discs from `at` on, by slices; the last ones are filled up with copies. */
static inline void slices_of(const uint at, const uint n, const uint n_samples, const uint n_tx,
                             const uint n_padded, __global const float *direction,
                             __global const float *tx_lobe, __global const float *alpha,
                             __global const float *rule, __global const uint *listed,
                             __global float *probability) {
    realw field[13];
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
        const uint which = listed[at + lane < n ? at + lane : at];
        const uint rx = which % n_padded, row = which / n_padded, i = row % n_samples;
        __global const float *t = tx_lobe + ((size_t)i * n_tx + row / n_samples) * CLR_TX_FIELDS;
        __global const float *r = direction + (size_t)i * CLR_RX_FIELDS * n_padded + rx;
        const float u = r[0], v = r[n_padded], w = r[2 * n_padded];
        float *column = (float *)field + lane;
        column[0] = u * t[3] + v * t[4] + w * t[5];
        column[CLR_WIDTH] = u * t[16] + v * t[17] + w * t[18];
        column[2 * CLR_WIDTH] = u * t[0] + v * t[1] + w * t[2];
        column[3 * CLR_WIDTH] = r[3 * n_padded];
        column[4 * CLR_WIDTH] = r[7 * n_padded];
        for (uint k = 0; k < 5; ++k) column[(5 + k) * CLR_WIDTH] = t[6 + k];
        column[10 * CLR_WIDTH] = t[14];
        column[11 * CLR_WIDTH] = t[15];
        column[12 * CLR_WIDTH] = alpha[i];
    }
    lobe l;
    l.n_z = field[5];
    l.n_x = field[6];
    l.g_x = field[7];
    l.g_y = field[8];
    l.g_z = field[9];
    l.edge = field[10];
    l.edge_cos = field[11];
    l.alpha = field[12];
    l.k = 1.0f - l.alpha;
    l.two = l.k - l.alpha > 0.0f;
    l.any_two = ANYW(l.two);
    const disc d = make_disc(field[0], field[1], field[2], field[3], field[4]);
    const realw height = l.g_x * field[0] + l.g_y * field[1] + l.g_z * field[2];
    const realw p = sliced_probability(l, d, (height < d.sine) | d.inside, rule);
    for (uint lane = 0; lane < CLR_WIDTH && at + lane < n; ++lane)
        probability[listed[at + lane]] = LANE(p, lane);
}

/* How many of n_here samples of CLR_WIDTH pairs have a P; below 2^24, so exact. */
static inline realw counted(const uint n_here, const uint n_padded, __global const float *probability) {
    realw sum = (realw)(0.0f);
    for (uint i = 0; i < n_here; ++i) {
        const realw p = LOADW(probability + (size_t)i * n_padded);
        sum += choose(p > LEAST_PROBABILITY, (realw)(1.0f), (realw)(0.0f));
    }
    return sum;
}

/* direction float (n_samples, CLR_RX_FIELDS, n_padded)
 * tx_lobe   float (n_samples, n_tx, CLR_TX_FIELDS)
 * alpha     float (n_samples)
 * rule      float, see common/lobe.h
 * probability  float (n_tx, n_samples, n_padded)  out: P, on a GPU but of those that are listed
 * n_listed  uint (2)                            in: 0; out: how many from the start and from the end, on a GPU
 * listed    uint (n_tx * n_samples * n_padded)  out: which, as indices into `probability`, in any order; on a CPU work
 *                                               space, each item's own part
 * count     float (n_tx, n_parts, n_padded)     out, on a CPU: samples of a part with a P of each pair */
__kernel void reception_probabilities(const uint n_samples, const uint n_tx, const uint n_padded,
                                      const uint share, const uint n_parts,
                                      __global const float *direction,
                                      __global const float *tx_lobe, __global const float *alpha,
                                      __global const float *rule, __global float *probability,
                                      __global uint *n_listed, __global uint *listed,
                                      __global float *count) {
    ITEM_OF_PAIRS
#if CLR_WIDTH == 8
    listed += ((size_t)tx * n_padded + first) * n_samples + begin * CLR_WIDTH;
    uint n_first = 0, n_last = 0;
    const uint capacity = (end - begin) * CLR_WIDTH;
#define AT_START n_first++
#define AT_END capacity - ++n_last
#else
    const uint capacity = n_tx * n_samples * n_padded;
#define AT_START atomic_inc(n_listed)
#define AT_END capacity - 1 - atomic_inc(n_listed + 1)
#endif
    for (uint i = begin; i < end; ++i) {
        __global const float *t = tx_lobe + ((size_t)i * n_tx + tx) * CLR_TX_FIELDS;
        __global const float *r = direction + (size_t)i * CLR_RX_FIELDS * n_padded + first;
        const uint at = (tx * n_samples + i) * n_padded + first;
        realw p = (realw)(0.0f);
        if (t[13] != 0.0f) {
            const realw u = LOADW(r), v = LOADW(r + n_padded), w = LOADW(r + 2 * n_padded);
            const realw sine = LOADW(r + 3 * n_padded), cosine = LOADW(r + 7 * n_padded);
            const realw x = shared_product(t + 3, u, v, w), y = shared_product(t + 16, u, v, w);
            const realw z = shared_product(t, u, v, w);
            const realw height = shared_product(t + 8, x, y, z);
            const float a = alpha[i];
            intw wanted = sine > 0.0f;
            if (a < LEAST_ALPHA) {
                const disc d = make_disc(x, y, z, sine, cosine);
                const intw hit = ((d.rho < d.sine) & (z > 0.0f)) | d.inside;
                p = choose(hit & wanted & (intw)(-(t[10] > 0.0f)), (realw)(1.0f), p);
            } else {
                lobe l;
                l.alpha = (realw)(a);
                l.k = (realw)(1.0f - a);
                l.any_two = (1.0f - a) - a > 0.0f;
                l.two = (intw)(-l.any_two);
                l.edge = (realw)(t[14]);
                l.edge_cos = (realw)(t[15]);
                /* Not out of the lobe's reach, nor below the face. */
                const realw within = lesser(sine, (realw)(1.0f));
                const intw near = (z > l.edge_cos * cosine - l.edge * within - 1e-5f) | !l.two;
                wanted &= ((height > -within) & near) | (sine > 1.0f);
                if (ANYW(wanted)) {
                    const disc d = make_disc(x, y, z, sine, cosine);
                    l.n_z = (realw)(t[6]);
                    l.n_x = (realw)(t[7]);
                    const intw smooth = wanted & is_smooth(l, d, height);
                    const intw rest = wanted & !smooth;
                    if (ANYW(smooth)) p = choose(smooth, smooth_probability(l, d), p);
                    if (ANYW(rest)) {
                        intw outer = rest & !rest;
                        if (l.any_two) outer = rest & cut_of(l, d).outer;
#pragma unroll
                        for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
                            if (!INT_LANE(rest, lane)) continue;
                            const uint to = INT_LANE(outer, lane) ? AT_END : AT_START;
                            listed[to] = at + lane;
                        }
                    }
                }
            }
        }
        STOREW(p, probability + at);
    }
#if CLR_WIDTH == 8
    for (uint last = 0; last < 2; ++last) {
        const uint n = last ? n_last : n_first;
        __global const uint *list = last ? listed + capacity - n : listed;
        for (uint at = 0; at < n; at += CLR_WIDTH)
            slices_of(at, n, n_samples, n_tx, n_padded, direction, tx_lobe, alpha, rule, list, probability);
    }
    STOREW(counted(end - begin, n_padded, probability + ((size_t)tx * n_samples + begin) * n_padded + first),
           count + ((size_t)tx * n_parts + part) * n_padded + first);
#endif
}

#if CLR_WIDTH == 1
/* P of the listed discs. Item = every n_items-th of them; arguments as above. */
__kernel void listed_probabilities(const uint n_items, const uint n_samples, const uint n_tx,
                                   const uint n_padded, __global const float *direction,
                                   __global const float *tx_lobe, __global const float *alpha,
                                   __global const float *rule, __global float *probability,
                                   __global const uint *n_listed, __global const uint *listed) {
    const uint item = (uint)get_global_id(0);
    if (item >= n_items) return;
    for (uint last = 0; last < 2; ++last) {
        const uint n = n_listed[last];
        __global const uint *list = last ? listed + n_tx * n_samples * n_padded - n : listed;
        for (uint at = item; at < n; at += n_items)
            slices_of(at, n, n_samples, n_tx, n_padded, direction, tx_lobe, alpha, rule, list, probability);
    }
}

/* Arguments as above. */
__kernel void count_probabilities(const uint n_samples, const uint n_tx, const uint n_padded,
                                  const uint share, const uint n_parts,
                                  __global const float *probability, __global float *count) {
    ITEM_OF_PAIRS
    STOREW(counted(end - begin, n_padded, probability + ((size_t)tx * n_samples + begin) * n_padded + first),
           count + ((size_t)tx * n_parts + part) * n_padded + first);
}
#endif

/* start  uint (n_tx * n_rx * n_parts + 1)  first path of each part of each pair
 * length     float (n_paths, 2)  out: hi and lo, metres
 * amplitude  float (n_paths)     out */
__kernel void expected_paths(const uint n_samples, const uint n_tx, const uint n_rx,
                             const uint n_padded, const uint share, const uint n_parts,
                             const float rays,
                             __global const float *direction, __global const float *tx_lobe,
                             __global const float *probability, __global const uint *start,
                             __global float *length, __global float *amplitude) {
    ITEM_OF_PAIRS
    uint next[CLR_WIDTH];
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
        const uint rx = first + lane;
        next[lane] = start[(tx * n_rx + (rx < n_rx ? rx : n_rx - 1)) * n_parts + part];
    }
    for (uint i = begin; i < end; ++i) {
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

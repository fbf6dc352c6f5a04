/* The lobe of outgoing directions of each sample and Tx: its axis t_m, and the normals in a frame about it.
 *
 * Item = one sample and one Tx, for expected.cl, which reads a lobe for many Rx. */
#if !defined(CLR_SPREADING) || !defined(CLR_GROUP) || !defined(CLR_TX_FIELDS)
#error "CLR_SPREADING, CLR_GROUP, CLR_TX_FIELDS are missing; see expected.cl"
#endif

#include "common/phase.h"
#include "common/vector.h"

/* antenna    float (n_tx, 6)         x, y, z as hi, then as lo, metres
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
    const dual x = dual_difference(p.x, 0.0f, a[0], a[3]);
    const dual y = dual_difference(p.y, 0.0f, a[1], a[4]);
    const dual z = dual_difference(p.z, 0.0f, a[2], a[5]);
    const dual segment = dual_length(x, y, z);
    const float3 t_i = (float3)(x.hi, y.hi, z.hi) / segment.hi;
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
    out[11] = segment.hi;
    out[12] = segment.lo;
    float weight = 1.0f;
#if CLR_SPREADING
    weight = 1.0f / segment.hi;
    if (pattern_exponent > 0.0f) {
        const float leaving = z.hi / segment.hi;
        weight *= leaving > 0.0f ? pow(leaving, pattern_exponent) : 0.0f;
    }
#endif
    out[13] = weight;
}

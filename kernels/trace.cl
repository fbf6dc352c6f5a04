/* Outgoing rays, bounces and receptions: steps 2 to 6 of the model.
 *
 * Item = PACK transmit antennas of one surface sample: eight on a CPU, one on a GPU. For every visible antenna and ray:
 *     t_i  unit direction of arrival             n facing it: n.t_i < 0
 *     t_d  = normalise(n + r), r uniform on the unit sphere             (diffuse)
 *     t_m  = t_i - 2 (t_i.n) n                                          (specular)
 *     t_c  = normalise(alpha t_d + (1 - alpha) t_m)                     (outgoing)
 * after J. Braeunig et al., EuRAD 2023. A draw with t_c below the geometric face is absorbed. The ray is
 * received by every Rx whose sphere of radius r it enters before it hits anything; the length of the path
 * is that to the sphere's centre. A ray that hits the mesh bounces there by the same rules. Rays start and hit on the
 * flat faces; directions and lengths are those of the points above them on the curved surface (common/curved.h).
 *
 * Receptions are appended in any order through an atomic counter; the host sorts them by `key`, so the order is
 * the same on every device. Nothing is written beyond `capacity`; when the counter passes it, the host launches the
 * kernel again with buffers for all. */
#ifndef CLR_SPREADING
#error "CLR_SPREADING (0: amplitude 1, 1: 1 / (R1 R2) and antenna patterns) is missing"
#endif

#ifndef CLR_GROUP
#error "CLR_GROUP (antennas of a group) is missing"
#endif

#include "common/phase.h"
#include "common/random.h"
#include "common/bvh.h"
#include "common/curved.h"

static inline dual dual_distance(float3 p, float3 a_hi, float3 a_lo) {
    return dual_length(dual_difference(p.x, 0.0f, a_hi.x, a_lo.x),
                       dual_difference(p.y, 0.0f, a_hi.y, a_lo.y),
                       dual_difference(p.z, 0.0f, a_hi.z, a_lo.z));
}

static inline dual distance_to(float3 p, __global const float *antenna) {
    return dual_distance(p, load3(antenna), load3(antenna + 3));
}

/* Distance along the ray at which it enters each sphere of PACK receivers; negative where it does not. A ray that
 * starts inside enters at 0. */
static inline packf sphere_entry(__global const float *rx, const uint stride, const float3 o,
                                  const float3 d, const float radius_squared) {
    const packf x = LOAD_PACK(rx) - o.x, y = LOAD_PACK(rx + stride) - o.y,
                z = LOAD_PACK(rx + 2 * stride) - o.z;
    const packf along = x * d.x + y * d.y + z * d.z;
    const packf px = x - along * d.x, py = y - along * d.y, pz = z - along * d.z;
    const packf miss_squared = px * px + py * py + pz * pz;
    const packf half_chord_squared = radius_squared - miss_squared;
    const packf half_chord = sqrt(half_chord_squared > 0.0f ? half_chord_squared : (packf)(0.0f));
    const packf entry = along - half_chord;
    const packi passed = (half_chord_squared > 0.0f) & (along + half_chord > 0.0f);
    return passed ? (entry > 0.0f ? entry : (packf)(0.0f)) : (packf)(-1.0f);
}

/* Slab test of a ray against the box around all receivers' spheres. */
static inline bool meets_box(const float3 o, const float3 d, const float4 low, const float4 high) {
    const float3 inverse = (float3)(safe_inverse(d.x), safe_inverse(d.y), safe_inverse(d.z));
    const float3 a = (low.xyz - o) * inverse, b = (high.xyz - o) * inverse;
    const float3 near = a < b ? a : b, far = a < b ? b : a;
    const float entry = larger(larger(near.x, near.y), near.z);
    const float leave = smaller(smaller(far.x, far.y), far.z);
    return leave > 0.0f && entry <= leave;
}

/* The largest entry distance of all receivers; negative if the ray meets none. */
static inline float farthest_entry(__global const float *rx, const uint stride, const float3 o,
                                   const float3 d, const float radius_squared) {
    float farthest = -1.0f;
#pragma unroll 1
    for (uint r = 0; r < stride; r += PACK)
        farthest = larger(farthest, -PACK_LEAST(-sphere_entry(rx + r, stride, o, d, radius_squared)));
    return farthest;
}

/* t_c for the random words of a draw. */
static inline float3 outgoing_direction(const uint4 words, const float3 n, const float3 t_i,
                                        const float alpha) {
    const float height = 2.0f * unit_interval(words.x) - 1.0f;
    const float ring = sqrt(larger(0.0f, 1.0f - height * height));
    float cosine, sine;
    cos_sin_cycles(unit_interval(words.y) - 0.5f, &cosine, &sine);
    const float3 r = (float3)(ring * cosine, ring * sine, height);
    const float3 t_d = unit(n + r);
    const float3 t_m = t_i - 2.0f * dot3(t_i, n) * n;
    return unit(alpha * t_d + (1.0f - alpha) * t_m);
}

/* nodes, triangles  see common/bvh.h
 * normal    float (n_faces, 3, 3)      unit normals at the corners
 * height    float (n_faces, 3, 2)      see common/curved.h
 * alpha     float (n_faces)
 * tx, rx    float (n, 6)               antennas, x, y, z as hi, then as lo, metres
 * rx_columns float (3, n_rx_groups * CLR_GROUP)  receivers by coordinate, padded with positions out of reach
 * ground, shading, geometric, point  float (n_samples, 3), see sample.cl   sample_alpha float (n_samples)
 * visible   uchar (n_samples, n_tx_groups)
 * counter   uint (3)                   receptions, outgoing draws, absorbed draws
 * key       ulong (capacity)           out: pair << 32 | (sample * rays + ray) * max_bounces + bounce
 * path      float (capacity, 4)        out: length hi, length lo, amplitude, unused; metres */
__kernel void trace_rays(
    const uint n_samples, const uint n_tx, const uint n_rx, const uint n_tx_groups,
    const uint n_rx_groups, const uint rays, const uint max_bounces, const uint first_sample,
    const uint seed_low, const uint seed_high, const float radius, const float pattern_exponent,
    const float delta, const float4 box_low, const float4 box_high, const uint capacity,
    __global const float *nodes, __global const float *triangles, __global const float *normal,
    __global const float *height, __global const float *alpha, __global const float *tx,
    __global const float *rx, __global const float *rx_columns, __global const float *ground,
    __global const float *shading, __global const float *geometric, __global const float *point,
    __global const float *sample_alpha, __global const uchar *visible, __global uint *counter,
    __global ulong *key, __global float *path) {
    const uint first_tx = (uint)get_global_id(0) * PACK, i = (uint)get_global_id(1);
    if (first_tx >= n_tx || i >= n_samples) return;
    const uint bits = visible[(size_t)i * n_tx_groups + first_tx / CLR_GROUP] >> first_tx % CLR_GROUP;
    if (bits == 0) return;
    const uint stride = n_rx_groups * CLR_GROUP;
    const float radius_squared = radius * radius;
    uint drawn = 0, absorbed = 0;

    for (uint b = 0; b < PACK; ++b) {
        if (!(bits & (1u << b))) continue;
        const uint which_tx = first_tx + b;
        __global const float *tx_m = tx + 6 * (size_t)which_tx;
        const float3 p0 = load3(point + 3 * (size_t)i);
        const dual first_segment = distance_to(p0, tx_m);
        const float3 arrival = (p0 - load3(tx_m)) / first_segment.hi;

        for (uint ray = 0; ray < rays; ++ray) {
            float3 p = p0, flat = load3(ground + 3 * (size_t)i), t_i = arrival;
            float3 n = load3(shading + 3 * (size_t)i), face = load3(geometric + 3 * (size_t)i);
            float a = sample_alpha[i];
            dual travelled = first_segment;

            for (uint bounce = 0; bounce < max_bounces; ++bounce) {
                if (dot3(n, t_i) > 0.0f) n = -n;
                if (dot3(face, t_i) > 0.0f) face = -face;

                const uint4 words = draw(first_sample + i, which_tx, ray,
                                         DOMAIN_DIRECTION | bounce << 8, seed_low, seed_high);
                const float3 t_c = outgoing_direction(words, n, t_i, a);
                ++drawn;
                /* Also true for NaN, where t_d and t_m cancel. */
                if (!(dot3(t_c, face) > 0.0f)) {
                    ++absorbed;
                    break;
                }

                const float3 o = flat + face * (2.0f * delta);
                const bool last = bounce + 1 == max_bounces;
                float farthest = -1.0f;
                if (meets_box(p, t_c, box_low, box_high))
                    farthest = farthest_entry(rx_columns, stride, p, t_c, radius_squared);
                if (last && farthest < 0.0f) break;

                const float reach = last ? farthest : FLT_MAX;
                const hit_record hit = intersect(nodes, triangles, o, t_c, reach, false);
                const float limit = hit.distance;

                if (farthest >= 0.0f) {
#pragma unroll 1
                    for (uint r = 0; r < stride; r += PACK) {
                        const packf entry =
                            sphere_entry(rx_columns + r, stride, p, t_c, radius_squared);
                        uint received = PACK_LANES((entry >= 0.0f) & (entry < limit));
                        if (!received) continue;
                        uint slot = atomic_add(counter, popcount(received));
                        for (; received && slot < capacity; received &= received - 1, ++slot) {
                            const uint which_rx = r + lowest(received);
                            __global const float *rx_m = rx + 6 * (size_t)which_rx;
                            const dual segment = distance_to(p, rx_m);
                            const dual total = dual_add(travelled, segment);
                            float amplitude = 1.0f;
#if CLR_SPREADING
                            amplitude = 1.0f / (travelled.hi * segment.hi);
                            if (pattern_exponent > 0.0f) {
                                const float leaving = (p0.z - tx_m[2]) / first_segment.hi;
                                const float back = (p.z - rx_m[2]) / segment.hi;
                                amplitude *= leaving > 0.0f && back > 0.0f
                                                 ? pow(leaving * back, pattern_exponent)
                                                 : 0.0f;
                            }
#endif
                            key[slot] = (ulong)(which_tx * n_rx + which_rx) << 32 |
                                        ((i * rays + ray) * max_bounces + bounce);
                            __global float *row = path + 4 * (size_t)slot;
                            row[0] = total.hi;
                            row[1] = total.lo;
                            row[2] = amplitude;
                            row[3] = 0.0f;
                        }
                    }
                }
                if (last || hit.triangle < 0) break;

                /* On to the next bounce. */
                __global const float *t = slot_of(triangles, hit.triangle);
                const int hit_face = face_at(nodes, triangles, hit.triangle);
                const float u = limited(hit.u, 0.0f, 1.0f);
                const float v = limited(hit.v, 0.0f, 1.0f - u);
                __global const float *corners = normal + 9 * (size_t)hit_face;
                flat = rows3(t) + u * rows3(t + ROW_E1) + v * rows3(t + ROW_E2);
                const float3 next = flat + curved_offset(height + 6 * (size_t)hit_face, corners, u, v);
                const dual segment = dual_distance(p, next, (float3)(0.0f));
                travelled = dual_add(travelled, segment);
                /* Not (next - p) / |next - p|: the ray started above p, which shows in short segments. */
                t_i = t_c;
                p = next;
                face = unit(rows3(t + ROW_N));
                const float3 blend = (1.0f - u - v) * load3(corners) + u * load3(corners + 3) +
                                     v * load3(corners + 6);
                const float norm = length3(blend);
                n = norm > 1e-6f ? blend / norm : face;
                a = alpha[hit_face];
            }
        }
    }
    if (drawn) atomic_add(counter + 1, drawn);
    if (absorbed) atomic_add(counter + 2, absorbed);
}

/* Outgoing rays, bounces and receptions: steps 2 to 6 of the model.
 *
 * For every visible antenna and ray of a surface sample:
 *     t_i  unit direction of arrival             n facing it: n.t_i < 0
 *     t_d  = normalise(n + r), r uniform on the unit sphere             (diffuse)
 *     t_m  = t_i - 2 (t_i.n) n                                          (specular)
 *     t_c  = normalise(alpha t_d + (1 - alpha) t_m)                     (outgoing)
 * after J. Braeunig et al., EuRAD 2023. A draw with t_c below the geometric face is absorbed. The ray is
 * received by every Rx whose sphere of radius r it enters before it hits anything; the length of the path
 * is that to the sphere's centre. A ray that hits the mesh bounces there by the same rules. Rays start and hit on the
 * flat faces; directions and lengths are those of the points above them on the curved surface (common/curved.h).
 *
 * Three kernels for some samples at a time, and a fourth for each further bounce, so that none holds more than a GPU has
 * registers for: `draw_rays` lists the rays that may come to anything, CLR_WIDTH antennas of a sample at a time;
 * `trace_rays` finds what each hits; `receive_rays` appends its receptions; `bounce_rays` lists the rays that go on. An
 * item of the last three takes an equal share of the list. The list has room for every ray that may be drawn.
 *
 * Receptions are appended in any order through an atomic counter, and counted by bins; receptions.cl brings them into an
 * order that is the same on every device. Nothing is written beyond `capacity`; when the counter passes it, the host
 * launches the kernels again with buffers for all. */
#ifndef CLR_SPREADING
#error "CLR_SPREADING (0: amplitude 1, 1: 1 / (R1 R2) and antenna patterns) is missing"
#endif

#ifndef CLR_GROUP
#error "CLR_GROUP (antennas of a group) is missing"
#endif

#include "common/phase.h"
#include "common/random_lanes.h"
#include "common/bvh.h"
#include "common/curved.h"

#if CLR_WIDTH != PACK
#error "rays are drawn, and receivers tested, CLR_WIDTH at a time"
#endif

/* Vectors of CLR_WIDTH antennas or rays. */
typedef struct {
    realw x, y, z;
} vectors;

static inline vectors all3(const float3 v) {
    return (vectors){(realw)(v.x), (realw)(v.y), (realw)(v.z)};
}

static inline void set3(vectors *v, const uint lane, const float3 to) {
    ((float *)&v->x)[lane] = to.x;
    ((float *)&v->y)[lane] = to.y;
    ((float *)&v->z)[lane] = to.z;
}

static inline realw dots(const vectors a, const vectors b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* v / |v|. */
static inline vectors units(const vectors v) {
    const realw length = sqrt(dots(v, v));
    return (vectors){v.x / length, v.y / length, v.z / length};
}

/* v, turned against t. */
static inline vectors against(const vectors v, const vectors t) {
    const intw along = dots(v, t) > 0.0f;
    return (vectors){choose(along, -v.x, v.x), choose(along, -v.y, v.y), choose(along, -v.z, v.z)};
}

static inline dual distances(const vectors p, const vectors a_hi, const vectors a_lo) {
    const realw zero = (realw)(0.0f);
    return dual_length(dual_difference(p.x, zero, a_hi.x, a_lo.x),
                       dual_difference(p.y, zero, a_hi.y, a_lo.y),
                       dual_difference(p.z, zero, a_hi.z, a_lo.z));
}

/* CLR_WIDTH antennas of columns x, y, z as hi, then as lo. */
static inline vectors load3w(__global const float *columns, const uint stride) {
    return (vectors){LOADW(columns), LOADW(columns + stride), LOADW(columns + 2 * stride)};
}

/* hi + lo > 0, the nearest float64 as lower and upper 32 bits: a device need not have float64. |lo| is at most half of
 * the last place of hi. Below 2^-74: 0. */
static inline uint2 as_float64(const float hi, const float lo) {
    int exponent = as_int(hi) >> 23;
    if (exponent < 53) return (uint2)(0);
    long digits = (as_int(hi) & 0x7fffff) | 0x800000;
    if (digits == 0x800000 && lo < 0.0f) { /* the sum has one bit less before the point */
        digits <<= 1;
        --exponent;
    }
    /* Adding 2^23 of the last of the 53 bits rounds to these. */
    const float most = as_float((exponent - 29) << 23), far = lo < 0.0f ? -most : most;
    const float rounded = absolute(lo) < most ? (lo + far) - far : lo;
    digits = (digits << 29) + (int)(rounded * as_float((306 - exponent) << 23));
    /* The leading bit of the digits adds 1 to the exponent. */
    const ulong bits = ((ulong)(exponent + 1022 - 127) << 52) + (ulong)digits;
    return (uint2)((uint)bits, (uint)(bits >> 32));
}

/* Distance along the ray at which it enters each sphere of CLR_WIDTH receivers; negative where it does not. A ray that
 * starts inside enters at 0. */
static inline realw sphere_entry(__global const float *rx, const uint stride, const float3 o,
                                 const float3 d, const float radius_squared) {
    const realw x = LOADW(rx) - o.x, y = LOADW(rx + stride) - o.y, z = LOADW(rx + 2 * stride) - o.z;
    const realw along = x * d.x + y * d.y + z * d.z;
    const realw px = x - along * d.x, py = y - along * d.y, pz = z - along * d.z;
    const realw miss_squared = px * px + py * py + pz * pz;
    const realw half_chord_squared = radius_squared - miss_squared;
    const realw half_chord = sqrt(greater(half_chord_squared, (realw)(0.0f)));
    const realw entry = along - half_chord;
    const intw passed = (half_chord_squared > 0.0f) & (along + half_chord > 0.0f);
    return choose(passed, greater(entry, (realw)(0.0f)), (realw)(-1.0f));
}

/* The largest entry distance of all receivers; negative if the ray meets none. */
static inline float farthest_entry(__global const float *rx, const uint stride, const float3 o,
                                   const float3 d, const float radius_squared) {
    float farthest = -1.0f;
#pragma unroll 1
    for (uint r = 0; r < stride; r += CLR_WIDTH)
        farthest = larger(farthest, -PACK_LEAST(-sphere_entry(rx + r, stride, o, d, radius_squared)));
    return farthest;
}

/* Slab test of rays against the box around all receivers' spheres. */
static inline intw meet_box(const vectors o, const vectors d, const float4 low, const float4 high) {
    realw entry = (realw)(-FLT_MAX), leave = (realw)(FLT_MAX);
    const realw origin[3] = {o.x, o.y, o.z}, direction[3] = {d.x, d.y, d.z};
    const float from[3] = {low.x, low.y, low.z}, to[3] = {high.x, high.y, high.z};
#pragma unroll
    for (int k = 0; k < 3; ++k) {
        const intw tiny = (direction[k] < 1e-18f) & (direction[k] > -1e-18f);
        const realw inverse = 1.0f / choose(tiny, (realw)(1e-18f), direction[k]);
        const realw a = (from[k] - origin[k]) * inverse, b = (to[k] - origin[k]) * inverse;
        entry = greater(entry, lesser(a, b));
        leave = lesser(leave, greater(a, b));
    }
    return (leave > 0.0f) & (entry <= leave);
}

/* t_c for the random words of draws. */
static inline vectors outgoing_directions(const uintw first_word, const uintw second_word,
                                          const vectors n, const vectors t_i, const realw alpha) {
    const realw height = 2.0f * unit_intervals(first_word) - 1.0f;
    const realw ring = sqrt(greater((realw)(0.0f), 1.0f - height * height));
    realw cosine, sine;
    cos_sin_cycles(unit_intervals(second_word) - 0.5f, &cosine, &sine);
    const vectors t_d = units((vectors){n.x + ring * cosine, n.y + ring * sine, n.z + height});
    const realw twice = 2.0f * dots(t_i, n), rest = 1.0f - alpha;
    return units((vectors){alpha * t_d.x + rest * (t_i.x - twice * n.x),
                           alpha * t_d.y + rest * (t_i.y - twice * n.y),
                           alpha * t_d.z + rest * (t_i.z - twice * n.z)});
}

/* A ray of the list. */
typedef struct {
    float4 from;     /* point on the curved surface; length of the path up to it as hi, */
    float4 along;    /* direction; and lo */
    float4 origin;   /* on the flat face; 1 where it meets the box around the receivers, else -1. As traced: u, v of
                      * the hit; unused; farthest entry into a sphere, or -1 */
    uint4 id;        /* sample * rays + ray; Tx; as traced: distance, slot of the triangle that is hit, or -1 */
} listed_ray;

/* Which rays are drawn, and how; tx_before: Tx of the array before the first of these, for the random numbers. */
typedef struct {
    uint bounce, tx_before, seed_low, seed_high;
    bool last;
    float delta;
    float4 box_low, box_high;
} drawing;

/* Draw the next direction of CLR_WIDTH paths, of which those of `alive` count, and list the rays that may come to
 * anything; returns how many were absorbed. */
static inline uint list_rays(const drawing how, const vectors p, const vectors flat,
                             const vectors t_i, vectors n, vectors face, const realw alpha,
                             const dual travelled, const uintw sample, const uintw tx,
                             const uintw ray, const uintw id, const uint alive,
                             __global uint *n_listed, __global listed_ray *list) {
    face = against(face, t_i);
    n = against(n, (vectors){-face.x, -face.y, -face.z});
    uintw first_word, second_word;
    draw_words(sample, tx + how.tx_before, ray, DOMAIN_DIRECTION | how.bounce << 8, how.seed_low, how.seed_high,
               &first_word, &second_word);
    const vectors t_c = outgoing_directions(first_word, second_word, n, t_i, alpha);
    /* Not of NaN either, where t_d and t_m cancel. */
    const uint left = PACK_LANES(dots(t_c, face) > 0.0f) & alive;
    const uint met = PACK_LANES(meet_box(p, t_c, how.box_low, how.box_high)) & left;
    uint wanted = how.last ? met : left;
    if (wanted) {
        const float above = 2.0f * how.delta;
        const vectors o = {flat.x + face.x * above, flat.y + face.y * above, flat.z + face.z * above};
        uint at = atomic_add(n_listed, popcount(wanted));
        for (; wanted; wanted &= wanted - 1, ++at) {
            const int b = lowest(wanted);
            __global listed_ray *to = list + at;
            to->from = (float4)(LANE(p.x, b), LANE(p.y, b), LANE(p.z, b), LANE(travelled.hi, b));
            to->along = (float4)(LANE(t_c.x, b), LANE(t_c.y, b), LANE(t_c.z, b), LANE(travelled.lo, b));
            to->origin = (float4)(LANE(o.x, b), LANE(o.y, b), LANE(o.z, b), met >> b & 1 ? 1.0f : -1.0f);
            to->id = (uint4)(UINT_LANE(id, b), UINT_LANE(tx, b), 0, 0);
        }
    }
    return popcount(alive & ~left);
}

/* Item = CLR_WIDTH Tx of one sample.
 *
 * n_samples of these from `start` of the tile on, and of their rays those from first_ray to last_ray.
 * nodes, triangles  see common/bvh.h
 * tx_columns float (6, tx_stride)      x, y, z as hi, then as lo, metres
 * ground, shading, geometric, point  float (n, 3), see sample.cl   sample_alpha float (n)
 * visible   uchar (n, n_tx_groups)
 * tally     uint (3 + n_tx * n_rx * n_bins)  receptions, draws of bounce_rays, absorbed draws; receptions of each pair
 *                                      and bin of `bin_samples` samples
 * n_listed  uint                       rays of lists, of which this is the list `counter`
 * list      listed_ray                 out */
__kernel void draw_rays(const uint n_samples, const uint start, const uint n_tx,
                        const uint n_tx_groups, const uint tx_stride, const uint rays,
                        const uint first_ray, const uint last_ray, const uint max_bounces,
                        const uint first_sample, const uint tx_before, const uint seed_low,
                        const uint seed_high, const float delta, const float4 box_low, const float4 box_high,
                        __global const float *tx_columns, __global const float *ground,
                        __global const float *shading, __global const float *geometric,
                        __global const float *point, __global const float *sample_alpha,
                        __global const uchar *visible, __global uint *tally, const uint counter,
                        __global uint *n_listed, __global listed_ray *list) {
    const uint first_tx = (uint)get_global_id(0) * CLR_WIDTH, item = (uint)get_global_id(1);
    if (first_tx >= n_tx || item >= n_samples) return;
    const uint i = start + item;
    const uint bits = visible[(size_t)i * n_tx_groups + first_tx / CLR_GROUP] >> first_tx % CLR_GROUP;
    const uint alive = bits & ((1u << CLR_WIDTH) - 1u);
    if (alive == 0) return;
    const drawing how = {0, tx_before, seed_low, seed_high, max_bounces == 1, delta, box_low, box_high};
    const vectors p = all3(load3(point + 3 * (size_t)i)), flat = all3(load3(ground + 3 * (size_t)i));
    const vectors n = all3(load3(shading + 3 * (size_t)i));
    const vectors face = all3(load3(geometric + 3 * (size_t)i));
    const vectors antenna = load3w(tx_columns + first_tx, tx_stride);
    const dual way = distances(p, antenna, load3w(tx_columns + 3 * tx_stride + first_tx, tx_stride));
    const vectors t_i = {(p.x - antenna.x) / way.hi, (p.y - antenna.y) / way.hi,
                         (p.z - antenna.z) / way.hi};
    const realw alpha = (realw)(sample_alpha[i]);
    const uintw tx = (uintw)(first_tx) + LANE_UINT;
    uint absorbed = 0;
    for (uint ray = first_ray; ray < last_ray; ++ray)
        absorbed += list_rays(how, p, flat, t_i, n, face, alpha, way, (uintw)(first_sample + i), tx,
                              (uintw)(ray), (uintw)(i * rays + ray), alive, n_listed + counter, list);
    if (absorbed) atomic_add(tally + 2, absorbed);
}

/* The part of n rays that one of `items` takes. */
typedef struct {
    uint begin, end;
} part;

static inline part my_part(const uint n, const uint items) {
    const uint share = n / items + (n % items != 0), begin = (uint)get_global_id(0) * share;
    return (part){begin, n < begin + share ? n : begin + share};
}

/* What each ray of a list hits before it has passed all spheres, or at all where there are further bounces.
 * rx_columns float (6, rx_stride)  receivers, as tx_columns, padded with NaN, which no ray meets */
__kernel void trace_rays(const uint items, const uint rx_stride, const uint last, const float radius,
                         __global const float *nodes, __global const float *triangles,
                         __global const float *rx_columns, const uint counter,
                         __global const uint *n_listed, __global listed_ray *list) {
    const part mine = my_part(n_listed[counter], items);
    for (uint k = mine.begin; k < mine.end; ++k) {
        __global listed_ray *ray = list + k;
        const float3 d = ray->along.xyz, o = ray->origin.xyz;
        float farthest = -1.0f;
        if (ray->origin.w > 0.0f)
            farthest = farthest_entry(rx_columns, rx_stride, ray->from.xyz, d, radius * radius);
        hit_record hit = {FLT_MAX, -1, 0.0f, 0.0f};
        if (!last || farthest >= 0.0f)
            hit = intersect(nodes, triangles, o, d, last ? farthest : FLT_MAX, false);
        ray->origin = (float4)(hit.u, hit.v, 0.0f, farthest);
        ray->id.zw = (uint2)(as_uint(hit.distance), (uint)hit.triangle);
    }
}

/* Append the receptions of a list.
 * tx_columns, point  as of draw_rays
 * key       ulong (capacity)           out: bin << 32 | (sample * rays + ray) * max_bounces + bounce
 * path      uint4 (capacity)           out: length as float64, metres, lower and upper 32 bits; amplitude, float; how
 *                                      many of its bin were appended before */
__kernel void receive_rays(const uint items, const uint n_rx, const uint rx_stride, const uint tx_stride,
                           const uint rays, const uint max_bounces, const uint bounce,
                           const float radius, const float pattern_exponent, const uint capacity,
                           const uint bin_samples, const uint n_bins,
                           __global const float *rx_columns, __global const float *tx_columns,
                           __global const float *point, const uint counter,
                           __global const uint *n_listed, __global const listed_ray *list,
                           __global uint *tally, __global ulong *key, __global uint4 *path) {
    const part mine = my_part(n_listed[counter], items);
    for (uint k = mine.begin; k < mine.end; ++k) {
        __global const listed_ray *ray = list + k;
        if (ray->origin.w < 0.0f) continue;
        const float3 p = ray->from.xyz, d = ray->along.xyz;
        const uint id = ray->id.x, tx = ray->id.y, i = id / rays;
        const float limit = as_float(ray->id.z);
        const dual travelled = {(realw)(ray->from.w), (realw)(ray->along.w)};
        float leaving = 0.0f;
#if CLR_SPREADING
        if (pattern_exponent > 0.0f) {
            __global const float *at = tx_columns + tx;
            const vectors p0 = all3(load3(point + 3 * (size_t)i));
            const vectors hi = all3((float3)(at[0], at[tx_stride], at[2 * tx_stride]));
            const vectors lo = all3((float3)(at[3 * tx_stride], at[4 * tx_stride], at[5 * tx_stride]));
            leaving = FIRSTW((p0.z - hi.z) / distances(p0, hi, lo).hi);
        }
#endif
#pragma unroll 1
        for (uint r = 0; r < rx_stride; r += CLR_WIDTH) {
            const realw entry = sphere_entry(rx_columns + r, rx_stride, p, d, radius * radius);
            uint received = PACK_LANES((entry >= 0.0f) & (entry < limit));
            if (!received) continue;
            const vectors rx = load3w(rx_columns + r, rx_stride);
            const dual segment = distances(all3(p), rx, load3w(rx_columns + 3 * rx_stride + r, rx_stride));
            const dual total = dual_add(travelled, segment);
            uint slot = atomic_add(tally, popcount(received));
            for (; received && slot < capacity; received &= received - 1, ++slot) {
                const uint lane = (uint)lowest(received);
                float amplitude = 1.0f;
#if CLR_SPREADING
                const float length = LANE(segment.hi, lane);
                amplitude = 1.0f / (ray->from.w * length);
                if (pattern_exponent > 0.0f) {
                    const float back = (p.z - LANE(rx.z, lane)) / length;
                    amplitude *= leaving > 0.0f && back > 0.0f ? pow(leaving * back, pattern_exponent)
                                                               : 0.0f;
                }
#endif
                const uint bin = (tx * n_rx + r + lane) * n_bins + i / bin_samples;
                key[slot] = (ulong)bin << 32 | (id * max_bounces + bounce);
                path[slot] = (uint4)(as_float64(LANE(total.hi, lane), LANE(total.lo, lane)),
                                     as_uint(amplitude), atomic_inc(tally + 3 + bin));
            }
        }
    }
}

/* From where the rays of a list hit, list those of bounce `bounce`, CLR_WIDTH at a time.
 * normal    float (n_faces, 3, 3)      unit normals at the corners
 * height    float (n_faces, 3, 2)      see common/curved.h
 * alpha     float (n_faces) */
__kernel void bounce_rays(const uint items, const uint rays, const uint max_bounces, const uint bounce,
                          const uint first_sample, const uint tx_before, const uint seed_low,
                          const uint seed_high, const float delta, const float4 box_low, const float4 box_high,
                          __global const float *nodes, __global const float *triangles,
                          __global const float *normal, __global const float *height,
                          __global const float *alpha, __global uint *tally, const uint counter,
                          __global uint *n_listed, __global const listed_ray *list,
                          __global listed_ray *next_list) {
    const part mine = my_part(n_listed[counter], items);
    const drawing how = {bounce, tx_before, seed_low, seed_high, bounce + 1 == max_bounces, delta,
                         box_low, box_high};
    uint drawn = 0, absorbed = 0;
    for (uint k = mine.begin; k < mine.end; k += CLR_WIDTH) {
        const realw zero = (realw)(0.0f);
        const vectors nothing = {zero, zero, zero};
        vectors p = nothing, flat = nothing, t_i = nothing, n = nothing, face = nothing, from = nothing;
        realw a = zero;
        dual travelled = {zero, zero};
        uintw id = (uintw)(0), tx = id;
        uint alive = 0;
        for (uint lane = 0; lane < CLR_WIDTH && k + lane < mine.end; ++lane) {
            __global const listed_ray *ray = list + k + lane;
            const int slot = (int)ray->id.w;
            if (slot < 0) continue;
            alive |= 1u << lane;
            __global const float *t = slot_of(triangles, slot);
            const int hit_face = face_at(nodes, triangles, slot);
            const float u = limited(ray->origin.x, 0.0f, 1.0f);
            const float v = limited(ray->origin.y, 0.0f, 1.0f - u);
            __global const float *corners = normal + 9 * (size_t)hit_face;
            const float3 on_face = rows3(t) + u * rows3(t + ROW_E1) + v * rows3(t + ROW_E2);
            const float3 normal_of = unit(rows3(t + ROW_N));
            const float3 blend = (1.0f - u - v) * load3(corners) + u * load3(corners + 3) +
                                 v * load3(corners + 6);
            const float norm = length3(blend);
            set3(&flat, lane, on_face);
            set3(&p, lane, on_face + curved_offset(height + 6 * (size_t)hit_face, corners, u, v));
            set3(&from, lane, ray->from.xyz);
            /* Not (p - from) / |p - from|: the ray started above, which shows in short segments. */
            set3(&t_i, lane, ray->along.xyz);
            set3(&face, lane, normal_of);
            set3(&n, lane, norm > 1e-6f ? blend / norm : normal_of);
            ((float *)&a)[lane] = alpha[hit_face];
            ((float *)&travelled.hi)[lane] = ray->from.w;
            ((float *)&travelled.lo)[lane] = ray->along.w;
            ((uint *)&id)[lane] = ray->id.x;
            ((uint *)&tx)[lane] = ray->id.y;
        }
        if (!alive) continue;
        travelled = dual_add(travelled, distances(from, p, nothing));
        const uintw i = id / rays;
        absorbed += list_rays(how, p, flat, t_i, n, face, a, travelled, first_sample + i, tx,
                              id - i * rays, id, alive, n_listed + counter + 1, next_list);
        drawn += popcount(alive);
    }
    if (drawn) atomic_add(tally + 1, drawn);
    if (absorbed) atomic_add(tally + 2, absorbed);
}

/* Which transmit antennas does each surface point see?
 *
 * Step 1 of the model: the ray Tx -> p counts if p is what it hits first. It is asked from the point's
 * side, since one origin with many directions shares most of the triangle test: item = one point and
 * 8 antennas, any hit, 8 directions at a time on a CPU and one after the other on a GPU.
 *
 * The origin is lifted off its face by `offset` = 2 delta towards the antenna (see common/bvh.h), so that
 * its own face and coincident ones are never hit. */
#include "common/width.h"
#include "common/bvh.h"

#define GROUP 8

/* Clear the lanes of `reach` (distance to each antenna; negative = done) that anything blocks. */
static inline realw blocked(__global const float *nodes, __global const float *triangles,
                            const float3 o, const realw dx, const realw dy, const realw dz,
                            realw reach) {
    const realw tiny = 1e-18f; /* keeps the inverses finite: no product with them is NaN */
    const realw ix = 1.0f / (((dx < tiny) & (dx > -tiny)) ? tiny : dx);
    const realw iy = 1.0f / (((dy < tiny) & (dy > -tiny)) ? tiny : dy);
    const realw iz = 1.0f / (((dz < tiny) & (dz > -tiny)) ? tiny : dz);
    int stack[CLR_STACK];
    int top = 0;
    int child = 0;
    for (;;) {
        if (child >= 0) {
            __global const float *node = nodes + (size_t)child * NODE_FLOATS;
            int hit[2];
            for (int side = 0; side < 2; ++side) {
                __global const float *box = node + 8 * side;
                realw a = (box[0] - o.x) * ix, b = (box[4] - o.x) * ix;
                realw near = a < b ? a : b, far = a < b ? b : a;
                a = (box[1] - o.y) * iy;
                b = (box[5] - o.y) * iy;
                realw n = a < b ? a : b, f = a < b ? b : a;
                near = near > n ? near : n;
                far = far < f ? far : f;
                a = (box[2] - o.z) * iz;
                b = (box[6] - o.z) * iz;
                n = a < b ? a : b;
                f = a < b ? b : a;
                near = near > n ? near : n;
                far = far < f ? far : f;
                near = near > 0.0f ? near : (realw)(0.0f);
                far = far < reach ? far : reach;
                hit[side] = ANYW(near <= far);
            }
            const int left = as_int(node[3]), right = as_int(node[7]);
            if (hit[0]) {
                if (hit[1]) stack[top++] = right;
                child = left;
                continue;
            }
            if (hit[1]) {
                child = right;
                continue;
            }
        } else {
            const int leaf = -(child + 1);
            const int first = leaf >> 4, count = leaf & 15;
            for (int i = first; i < first + count; ++i) {
                __global const float *t = triangles + (size_t)i * TRIANGLE_FLOATS;
                const float3 e1 = load3(t + 4), e2 = load3(t + 8), n = load3(t + 12);
                const float3 to = load3(t) - o;
                const float3 q2 = cross3(e2, to), q1 = cross3(to, e1);
                const float tn = dot3(to, n);
                const realw dn = dx * n.x + dy * n.y + dz * n.z;
                const realw sign = dn < 0.0f ? (realw)(-1.0f) : (realw)(1.0f);
                const realw size = dn * sign;
                const realw u = (dx * q2.x + dy * q2.y + dz * q2.z) * sign;
                const realw v = (dx * q1.x + dy * q1.y + dz * q1.z) * sign;
                const realw distance = tn * sign;
                const float error = edge_error(to), eu = error * t[11], ev = error * t[7];
                const float ew = eu + ev + t[15];
                intw hit = (u >= -eu) & (v >= -ev) & (u + v <= size + ew) & (size > t[15]) &
                           (distance > 0.0f) & (distance < reach * size);
                const intw unsure = hit & ((u <= eu) | (v <= ev) | (u + v >= size - ew));
                if (ANYW(unsure)) {
                    const intw inside = inside_triangle(t, o, dx, dy, dz);
                    hit = unsure ? inside : hit;
                }
                reach = hit ? (realw)(-1.0f) : reach;
            }
            if (!ANYW(reach > 0.0f)) return reach;
        }
        if (top == 0) return reach;
        child = stack[--top];
    }
}

/* Which antennas of a group of 8 a point sees, as bits.
 *
 * An antenna is a sphere of this radius, or a point (0). Where the plane of the point's face cuts a sphere, each side
 * asks for the middle of its own part, in height above the face. */
static inline uchar seen_from(const float3 p, const float3 normal, const uint n_antennas,
                              const uint n_groups, const uint group, const float delta,
                              const float radius, __global const float *nodes,
                              __global const float *triangles, __global const float *antenna) {
    const uint stride = n_groups * GROUP;
    const float offset = 2.0f * delta;
    uint bits = 0;
    for (uint start = 0; start < GROUP; start += CLR_WIDTH) {
        __global const float *at = antenna + group * GROUP + start;
        const realw ax = LOADW(at), ay = LOADW(at + stride), az = LOADW(at + 2 * stride);
        const realw height = (ax - p.x) * normal.x + (ay - p.y) * normal.y + (az - p.z) * normal.z;
        const realw lane = LANE_INDEX + (float)(group * GROUP + start);
        const intw real_antenna = lane < (float)n_antennas;
        /* The face is two-sided; antennas on either side of its plane need their own origin. */
        for (int side = -1; side <= 1; side += 2) {
            const realw above = height * (float)side;
            const intw wanted = (above > -radius) & real_antenna;
            if (!ANYW(wanted)) continue;
            const float3 o = p + normal * ((float)side * offset);
            const realw missing = above < radius ? radius - above : (realw)(0.0f);
            const realw lift = missing * (0.5f * (float)side);
            realw dx = ax - o.x + lift * normal.x, dy = ay - o.y + lift * normal.y;
            realw dz = az - o.z + lift * normal.z;
            const realw distance = sqrt(dx * dx + dy * dy + dz * dz);
            dx /= distance;
            dy /= distance;
            dz /= distance;
            realw reach = wanted ? distance : (realw)(-1.0f);
            reach = blocked(nodes, triangles, o, dx, dy, dz, reach);
            const intw seen = reach > 0.0f;
#if CLR_WIDTH == 8
            const int8 weights = (int8)(1, 2, 4, 8, 16, 32, 64, 128);
            const int8 set = seen ? weights : (int8)(0);
            const int4 four = set.lo | set.hi;
            const int2 two = four.lo | four.hi;
            bits |= (uint)(two.x | two.y);
#else
            bits |= seen ? 1u << start : 0u;
#endif
        }
    }
    return (uchar)bits;
}

/* nodes, triangles  see common/bvh.h
 * tx        float (3, n_groups * 8)  antennas, metres; padded with copies of the last
 * point     float (n_samples, 3)     metres
 * geometric float (n_samples, 3)     unit face normals
 * visible   uchar (n_samples, n_groups)  out: bit b of group g is set if antenna 8 g + b is seen */
__kernel void visible_antennas(const uint n_samples, const uint n_tx, const uint n_groups,
                               const float delta, __global const float *nodes,
                               __global const float *triangles, __global const float *tx,
                               __global const float *point, __global const float *geometric,
                               __global uchar *visible) {
    const uint i = (uint)get_global_id(0), group = (uint)get_global_id(1);
    if (i >= n_samples || group >= n_groups) return;
    visible[(size_t)i * n_groups + group] =
        seen_from(load3(point + 3 * (size_t)i), load3(geometric + 3 * (size_t)i), n_tx, n_groups,
                  group, delta, 0.0f, nodes, triangles, tx);
}

/* The same of receivers, which are spheres. */
__kernel void visible_spheres(const uint n_samples, const uint n_rx, const uint n_groups,
                              const float delta, const float radius, __global const float *nodes,
                              __global const float *triangles, __global const float *rx,
                              __global const float *point, __global const float *geometric,
                              __global uchar *visible) {
    const uint i = (uint)get_global_id(0), group = (uint)get_global_id(1);
    if (i >= n_samples || group >= n_groups) return;
    visible[(size_t)i * n_groups + group] =
        seen_from(load3(point + 3 * (size_t)i), load3(geometric + 3 * (size_t)i), n_rx, n_groups,
                  group, delta, radius, nodes, triangles, rx);
}

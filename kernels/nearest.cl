/* Closest-hit queries for rays given one by one. Item = one ray. */
#include "common/width.h"
#include "common/bvh.h"

#define AHEAD 4 /* rays that are prefetched */

/* Spread the five bits of a coordinate two apart; clamped to 0 to 31, also NaN. */
static inline uint spread(const float at) {
    uint k = (uint)smaller(larger(at, 0.0f), 31.0f);
    k = (k | k << 8) & 0x100f;
    k = (k | k << 4) & 0x10c3;
    return (k | k << 2) & 0x1249;
}

/* Morton code of each ray's origin in a grid over all boxes (G. M. Morton, IBM 1966): rays in that order find in
 * the cache what their predecessors read.
 *
 * cell  ushort (n_rays)  out: 5 bits by axis, interleaved */
__kernel void ray_cells(const uint n_rays, __global const float *nodes, __global const float *origin,
                        __global ushort *cell) {
    const uint i = (uint)get_global_id(0);
    if (i >= n_rays) return;
    const float3 low = load3(nodes + NODE_BOUNDS), size = load3(nodes + NODE_BOUNDS + 3) - low;
    const float scale = 32.0f / larger(larger(size.x, size.y), larger(size.z, 1e-30f));
    const float3 o = (load3(origin + 3 * (size_t)i) - low) * scale;
    cell[i] = (ushort)(spread(o.x) | spread(o.y) << 1 | spread(o.z) << 2);
}

/* nodes, triangles  see common/bvh.h
 * order             uint (n_rays)      the ray that each item traces
 * origin, direction float (n_rays, 3)  metres; unit vectors
 * distance  float (n_rays)             out: metres; negative: nothing is hit
 * face      int (n_rays)               out: -1: nothing is hit
 * weights   float (n_rays, 2)          out: of the face's second and third corner */
__kernel void nearest_hits(const uint n_rays, __global const float *nodes,
                           __global const float *triangles, __global const uint *order,
                           __global const float *origin,
                           __global const float *direction, __global float *distance,
                           __global int *face, __global float *weights) {
    if (get_global_id(0) >= n_rays) return;
    const uint i = order[get_global_id(0)];
    const size_t soon = order[min((uint)get_global_id(0) + AHEAD, n_rays - 1)];
    fetch(origin + 3 * soon);
    fetch(direction + 3 * soon);
    fetch(distance + soon);
    fetch((__global float *)face + soon);
    fetch(weights + 2 * soon);
    const hit_record hit = intersect(nodes, triangles, load3(origin + 3 * (size_t)i),
                                  load3(direction + 3 * (size_t)i), FLT_MAX, false);
    distance[i] = hit.triangle < 0 ? -1.0f : hit.distance;
    face[i] = hit.triangle < 0 ? -1 : face_at(nodes, triangles, hit.triangle);
    weights[2 * (size_t)i] = hit.u;
    weights[2 * (size_t)i + 1] = hit.v;
}

/* What rays hit first: the question of step 5 of the model, asked for rays given one by one. Item = one ray. */
#include "common/width.h"
#include "common/bvh.h"

/* nodes, triangles  see common/bvh.h
 * origin, direction float (n_rays, 3)  metres; unit vectors
 * distance  float (n_rays)             out: metres; negative: nothing is hit
 * face      int (n_rays)               out: -1: nothing is hit
 * weights   float (n_rays, 2)          out: of the face's second and third corner */
__kernel void nearest_hits(const uint n_rays, __global const float *nodes,
                           __global const float *triangles, __global const float *origin,
                           __global const float *direction, __global float *distance,
                           __global int *face, __global float *weights) {
    const uint i = (uint)get_global_id(0);
    if (i >= n_rays) return;
    const hit_record hit = traced(nodes, triangles, load3(origin + 3 * (size_t)i),
                                  load3(direction + 3 * (size_t)i), FLT_MAX, false);
    distance[i] = hit.distance;
    face[i] = hit.triangle < 0 ? -1 : face_at(nodes, triangles, hit.triangle);
    weights[2 * (size_t)i] = hit.u;
    weights[2 * (size_t)i + 1] = hit.v;
}

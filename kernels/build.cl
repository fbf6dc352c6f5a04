/* Building a bounding volume hierarchy, one level at a time: every node is split in two by the binned surface area
 * heuristic (I. Wald, "On fast construction of SAH-based bounding volume hierarchies", IEEE Symposium on Interactive
 * Ray Tracing 2007). Item = one node, which goes through its triangles one by one: for CPUs
 * (clradar/geometry/node_splits.py has the same in numpy). */
#include "common/width.h"
#include "common/vector.h"

#ifndef CLR_BLOCK
#error "CLR_BLOCK (triangles of a leaf) is missing"
#endif

#define BINS 16

/* A box as (-low, high), so that the box around two is the larger of each component. */
#define NOTHING ((float8)(-FLT_MAX))

/* Half the surface. */
static inline float area(const float8 box) {
    const float4 size = box.lo + box.hi;
    return size.x * size.y + size.y * size.z + size.z * size.x;
}

/* Cost of a leaf. */
static inline float blocks(const int count) {
    return (float)((count + CLR_BLOCK - 1) / CLR_BLOCK);
}

/* Bin of one coordinate, valid for NaN and infinity too. */
static inline int bin_of(const float centre, const float low, const float scale) {
    const float at = (centre - low) * scale;
    return at < (float)(BINS - 1) ? (at > 0.0f ? (int)at : 0) : BINS - 1;
}

static inline float component(const float4 v, const int axis) {
    return axis == 0 ? v.x : axis == 1 ? v.y : v.z;
}

/* boxes     float (n_triangles, 8)  -low x, y, z, 0, high x, y, z, 0; metres
 * start, count  int (n_nodes)       range in `order` of each node; nodes do not overlap
 * order     int (n_triangles)       in and out: a stable partition, left child first
 * scratch   int (n_triangles)
 * n_left    int (n_nodes)           out
 * children  float (n_nodes, 2, 8)   out: boxes of both children
 * With `halve`, and where no plane separates the centres, a node is split by count. */
__kernel void split_nodes(const uint n_nodes, const uint halve, __global const float *boxes,
                          __global const int *start, __global const int *count,
                          __global int *order, __global int *scratch, __global int *n_left,
                          __global float *children) {
    const uint node = (uint)get_global_id(0);
    if (node >= n_nodes) return;
    __global int *mine = order + start[node], *others = scratch + start[node];
    const int n = count[node];

    /* Twice the bounds of the centres. */
    float4 low = (float4)(FLT_MAX), high = (float4)(-FLT_MAX);
    for (int i = 0; i < n; ++i) {
        const float8 box = LOAD8(boxes + 8 * (size_t)mine[i]);
        const float4 centre = box.hi - box.lo;
        low = centre < low ? centre : low;
        high = centre > high ? centre : high;
    }
    const float4 extent = high - low;
    const float scales[3] = {extent.x > 0.0f ? BINS / extent.x : 0.0f,
                             extent.y > 0.0f ? BINS / extent.y : 0.0f,
                             extent.z > 0.0f ? BINS / extent.z : 0.0f};

    int axis = -1, plane = 0;
    if (!halve) {
        float8 bin[3 * BINS];
        int amount[3 * BINS];
        for (int k = 0; k < 3 * BINS; ++k) {
            bin[k] = NOTHING;
            amount[k] = 0;
        }
        for (int i = 0; i < n; ++i) {
            const float8 box = LOAD8(boxes + 8 * (size_t)mine[i]);
            const float4 centre = box.hi - box.lo;
            const int x = bin_of(centre.x, low.x, scales[0]);
            const int y = BINS + bin_of(centre.y, low.y, scales[1]);
            const int z = 2 * BINS + bin_of(centre.z, low.z, scales[2]);
            bin[x] = larger8(bin[x], box);
            bin[y] = larger8(bin[y], box);
            bin[z] = larger8(bin[z], box);
            ++amount[x];
            ++amount[y];
            ++amount[z];
        }
        float best = FLT_MAX;
        for (int k = 0; k < 3; ++k) {
            float right_cost[BINS];
            float8 box = NOTHING;
            int held = 0;
            for (int p = BINS - 1; p > 0; --p) {
                box = larger8(box, bin[k * BINS + p]);
                held += amount[k * BINS + p];
                right_cost[p] = held ? area(box) * blocks(held) : FLT_MAX;
            }
            box = NOTHING;
            held = 0;
            for (int p = 1; p < BINS; ++p) {
                box = larger8(box, bin[k * BINS + p - 1]);
                held += amount[k * BINS + p - 1];
                const float cost = held ? area(box) * blocks(held) + right_cost[p] : FLT_MAX;
                if (cost < best) {
                    best = cost;
                    axis = k;
                    plane = p;
                }
            }
        }
    }

    const float from = axis < 0 ? 0.0f : component(low, axis);
    const float scale = axis < 0 ? 0.0f : scales[axis];
    float8 left = NOTHING, right = NOTHING;
    int n_first = 0, n_second = 0;
    for (int i = 0; i < n; ++i) {
        const int triangle = mine[i];
        const float8 box = LOAD8(boxes + 8 * (size_t)triangle);
        const bool first = axis < 0 ? i < n / 2
                                    : bin_of(component(box.hi - box.lo, axis), from, scale) < plane;
        if (first) {
            left = larger8(left, box);
            mine[n_first++] = triangle;
        } else {
            right = larger8(right, box);
            others[n_second++] = triangle;
        }
    }
    for (int i = 0; i < n_second; ++i) mine[n_first + i] = others[i];
    n_left[node] = n_first;
    ((__global loose8 *)(children + 16 * (size_t)node))->v = left;
    ((__global loose8 *)(children + 16 * (size_t)node + 8))->v = right;
}

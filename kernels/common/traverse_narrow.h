/* Traversal for a GPU: neighbouring items are the lanes, so each ray takes few registers and a short stack (layout:
 * common/bvh.h). CLR_STACK: nodes with children that wait, at most one per level. */

/* Where a ray enters and leaves four boxes of a node, from `first` on, within reach. */
static inline void enter4(__global const float *first, const slabs in, const float3 inverse,
                          const float3 moved, const float reach, float4 *near, float4 *far) {
#pragma OPENCL FP_CONTRACT ON
    const int both = NODE_LOW + NODE_HIGH;
    const float4 x0 = LOAD4(first + in.x) * inverse.x + moved.x;
    const float4 y0 = LOAD4(first + in.y) * inverse.y + moved.y;
    const float4 z0 = LOAD4(first + in.z) * inverse.z + moved.z;
    const float4 x1 = LOAD4(first + both - in.x) * inverse.x + moved.x;
    const float4 y1 = LOAD4(first + both + 16 - in.y) * inverse.y + moved.y;
    const float4 z1 = LOAD4(first + both + 32 - in.z) * inverse.z + moved.z;
    const float4 zero = (float4)(0.0f), most = (float4)(reach);
    const float4 near_xy = x0 > y0 ? x0 : y0, near_z = z0 > zero ? z0 : zero;
    const float4 far_xy = x1 < y1 ? x1 : y1, far_z = z1 < most ? z1 : most;
    *near = near_xy > near_z ? near_xy : near_z;
    *far = far_xy < far_z ? far_xy : far_z;
}

/* Whether a ray meets one box of a node within reach. */
static inline bool meets(__global const float *box, const slabs in, const float3 inverse,
                         const float3 moved, const float reach) {
#pragma OPENCL FP_CONTRACT ON
    const int both = NODE_LOW + NODE_HIGH;
    const float x0 = box[in.x] * inverse.x + moved.x, x1 = box[both - in.x] * inverse.x + moved.x;
    const float y0 = box[in.y] * inverse.y + moved.y;
    const float y1 = box[both + 16 - in.y] * inverse.y + moved.y;
    const float z0 = box[in.z] * inverse.z + moved.z;
    const float z1 = box[both + 32 - in.z] * inverse.z + moved.z;
    return larger(larger(x0, y0), larger(z0, 0.0f)) <= smaller(smaller(x1, y1), smaller(z1, reach));
}

#define IN_ORDER(a, b) \
    do { \
        const uint less_ = min(a, b); \
        b = max(a, b); \
        a = less_; \
    } while (0)

/* The children of a node that a ray meets within reach, from near to far: their number in bits 24 and up, below it
 * three bits for each, the nearest lowest. */
static inline uint children_met(__global const float *node, const slabs in, const float3 inverse,
                                const float3 moved, const float reach) {
    /* Distances are not negative, so their bits sort as they do; the last three make room for the child. */
    uint key[CLR_CHILDREN];
    uint n = 0;
#pragma unroll
    for (uint k = 0; k < CLR_CHILDREN; k += 4) {
        float4 near, far;
        enter4(node + k, in, inverse, moved, reach, &near, &far);
        key[k] = near.x <= far.x ? (as_uint(near.x) & ~7u) | k : ~0u;
        key[k + 1] = near.y <= far.y ? (as_uint(near.y) & ~7u) | (k + 1) : ~0u;
        key[k + 2] = near.z <= far.z ? (as_uint(near.z) & ~7u) | (k + 2) : ~0u;
        key[k + 3] = near.w <= far.w ? (as_uint(near.w) & ~7u) | (k + 3) : ~0u;
    }
    /* K. E. Batcher, "Sorting networks and their applications", AFIPS 1968. */
    IN_ORDER(key[0], key[1]); IN_ORDER(key[2], key[3]); IN_ORDER(key[4], key[5]); IN_ORDER(key[6], key[7]);
    IN_ORDER(key[0], key[2]); IN_ORDER(key[1], key[3]); IN_ORDER(key[4], key[6]); IN_ORDER(key[5], key[7]);
    IN_ORDER(key[1], key[2]); IN_ORDER(key[5], key[6]); IN_ORDER(key[0], key[4]); IN_ORDER(key[3], key[7]);
    IN_ORDER(key[1], key[5]); IN_ORDER(key[2], key[6]); IN_ORDER(key[1], key[4]); IN_ORDER(key[3], key[6]);
    IN_ORDER(key[2], key[4]); IN_ORDER(key[3], key[5]); IN_ORDER(key[3], key[4]);
    uint order = 0;
#pragma unroll
    for (uint k = 0; k < CLR_CHILDREN; ++k) {
        order |= (key[k] & 7u) << 3 * k;
        n += key[k] != ~0u;
    }
    return order | n << 24;
}

/* Closest hit along o + t d, 0 < t < limit; with `any`, the first that is found. */
static inline hit_record intersect(__global const float *nodes, __global const float *triangles,
                                   const float3 o, const float3 d, const float limit,
                                   const bool any) {
    const float3 inverse = (float3)(safe_inverse(d.x), safe_inverse(d.y), safe_inverse(d.z));
    const float3 moved = -o * inverse;
    const slabs slab = slabs_of(inverse);
    hit_record best = {FLT_MAX, -1, 0.0f, 0.0f};
    float reach = limit;
    int family[CLR_STACK];
    uint waiting[CLR_STACK]; /* children of it, as of children_met */
    int top = 0, child = 0;
    for (;;) {
        if (child >= 0) {
            family[top] = child;
            waiting[top] = children_met(nodes + (size_t)child * NODE_FLOATS, slab, inverse, moved, reach);
            top += waiting[top] >> 24 != 0;
        } else {
            hit_block(triangles, -(child + 1), o, d, limit, &best);
            if (any && best.triangle >= 0) return best;
            reach = smaller(limit, best.distance);
        }
        for (bool found = false; !found;) {
            if (top == 0) return best;
            const uint order = waiting[top - 1], left = (order >> 24) - 1;
            __global const float *box = nodes + (size_t)family[top - 1] * NODE_FLOATS + (order & 7u);
            waiting[top - 1] = (order & 0xffffffu) >> 3 | left << 24;
            top -= left == 0;
            found = meets(box, slab, inverse, moved, reach);
            child = as_int(box[0]);
        }
    }
}

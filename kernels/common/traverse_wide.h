/* Traversals for a CPU: a node's eight boxes at a time (layout: common/bvh.h). CLR_STACK: children that wait. */
/* Prefetch a child that will be visited. */
static inline void fetch_child(__global const float *nodes, __global const float *triangles,
                               const int child) {
    fetch384(child >= 0 ? nodes + (size_t)child * NODE_FLOATS
                        : triangles + (size_t)-(child + 1) * BLOCK_FLOATS);
}

/* Slab test: boxes of a node that a ray meets within reach, as bits, and where it enters them. */
static inline uint boxes_hit(__global const float *node, const slabs in, const float3 inverse,
                             const float3 moved, const float reach, float8 *near) {
    const int both = NODE_LOW + NODE_HIGH;
    *near = larger8(larger8(fused_pack(LOAD8(node + in.x), (float8)(inverse.x), (float8)(moved.x)),
                            fused_pack(LOAD8(node + in.y), (float8)(inverse.y), (float8)(moved.y))),
                    larger8(fused_pack(LOAD8(node + in.z), (float8)(inverse.z), (float8)(moved.z)),
                            (float8)(0.0f)));
    const float8 far = smaller8(
        smaller8(fused_pack(LOAD8(node + both - in.x), (float8)(inverse.x), (float8)(moved.x)),
                 fused_pack(LOAD8(node + both + 16 - in.y), (float8)(inverse.y), (float8)(moved.y))),
        smaller8(fused_pack(LOAD8(node + both + 32 - in.z), (float8)(inverse.z), (float8)(moved.z)),
                 (float8)(reach)));
    return lanes8(*near <= far);
}

/* Closest hit along o + t d, 0 < t < limit; with `any`, the first that is found. Children are visited from near to
 * far. */
static inline hit_record intersect(__global const float *nodes, __global const float *triangles,
                                const float3 o, const float3 d, const float limit, const bool any) {
    const float3 inverse = (float3)(safe_inverse(d.x), safe_inverse(d.y), safe_inverse(d.z));
    const float3 moved = -o * inverse;
    const slabs slab = slabs_of(inverse);
    hit_record best = {FLT_MAX, -1, 0.0f, 0.0f};
    float reach = limit;
    int stack[CLR_STACK];
    float entry[CLR_STACK];
    int top = 0;
    int child = 0;
    for (;;) {
        if (child >= 0) {
            __global const float *node = nodes + (size_t)child * NODE_FLOATS;
            float8 near;
            uint hit = boxes_hit(node, slab, inverse, moved, reach, &near);
            if (hit) {
                __global const int *children = (__global const int *)node;
                const int one = lowest(hit);
                hit &= hit - 1;
                child = children[one];
                if (!hit) continue;
                float at[8];
                ((loose8 *)at)->v = near;
                float d0 = at[one];
                const int base = top;
                do {
                    const int lane = lowest(hit);
                    hit &= hit - 1;
                    int next = children[lane];
                    float dn = at[lane];
                    if (dn < d0) {
                        const int c = child; child = next; next = c;
                        const float q = d0; d0 = dn; dn = q;
                    }
                    int place = top++;
                    for (; place > base && entry[place - 1] < dn; --place) {
                        entry[place] = entry[place - 1];
                        stack[place] = stack[place - 1];
                    }
                    entry[place] = dn;
                    stack[place] = next;
                    fetch_child(nodes, triangles, next);
                } while (hit);
                continue;
            }
        } else {
            hit_block(triangles, -(child + 1), o, d, limit, &best);
            if (any && best.triangle >= 0) return best;
            reach = smaller(limit, best.distance);
        }
        do {
            if (top == 0) return best;
            child = stack[--top];
        } while (entry[top] > reach);
    }
}

/* Whether a point is inside a closed surface, by the parity of the faces that one ray to infinity crosses. Then every
 * ray from it to a point outside of all boxes is blocked. False where an edge is too close to the ray, or a face to
 * the point, to count in float32. */
static inline bool inside_closed(__global const float *nodes, __global const float *triangles,
                                 const float3 o, const float3 d, const float delta) {
    const float3 inverse = (float3)(safe_inverse(d.x), safe_inverse(d.y), safe_inverse(d.z));
    const float3 moved = -o * inverse;
    const slabs slab = slabs_of(inverse);
    int stack[CLR_STACK];
    int top = 0, child = 0;
    uint count = 0;
    for (;;) {
        if (child >= 0) {
            __global const float *node = nodes + (size_t)child * NODE_FLOATS;
            float8 near;
            uint hit = boxes_hit(node, slab, inverse, moved, FLT_MAX, &near);
            for (; hit; hit &= hit - 1) {
                stack[top] = ((__global const int *)node)[lowest(hit)];
                fetch_child(nodes, triangles, stack[top++]);
            }
        } else {
            const block_tests s =
                block_from(triangles + (size_t)-(child + 1) * BLOCK_FLOATS, o, 0, 1, 2);
            const packf size = along_pack(s.nx, s.ny, s.nz, d);
            const float8 u = along_pack(s.q2x, s.q2y, s.q2z, d), v = along_pack(s.q1x, s.q1y, s.q1z, d);
            const int8 maybe = (u >= -s.eu) & (v >= -s.ev) & (u + v <= size + s.ew) &
                               (size >= -s.edge_on) & (s.edge_on > 0.0f);
            const int8 surely = maybe & (u > s.eu) & (v > s.ev) & (u + v < size - s.ew) &
                                (size > s.edge_on) & (s.height > delta * 0x1p21f * s.edge_on);
            if (any8(maybe & ~surely)) return false;
            count += popcount(lanes8(surely));
        }
        if (top == 0) return count & 1;
        child = stack[--top];
    }
}

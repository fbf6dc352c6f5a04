/* Visibility of antennas from surface points (docs/equations.md, E2), by shaft culling (E. A. Haines and
 * J. R. Wallace, "Shaft culling for efficient ray-traced radiosity", Eurographics Workshop on Rendering 1991).
 *
 * The ray Tx -> p counts if p is what it hits first. Rays are traced from the point, since one origin with many
 * directions shares most of the work: any hit ends a ray.
 *
 * On a CPU, item = one point. The antennas come in bundles of up to 8 groups of up to 8 that are close to
 * each other. One pass through the tree serves a bundle: the shaft from the point around all its
 * antennas is tested against the boxes of 8 children at a time, then against the 8 triangles of a leaf,
 * and so is the shaft of each group. What is left is decided for one triangle and the 8 rays of a group
 * at a time. The shafts only save work: what blocks a ray is decided for each ray by itself.
 *
 * On a GPU, item = 8 antennas of one point, one ray after the other; neighbouring items have the other antennas of
 * the point.
 *
 * Half of the points of a closed surface would have their rays go through what it encloses. On a CPU one ray decides
 * whether a point's side is inside (inside_closed); then no antenna outside of all boxes is visible. On a GPU these
 * rays are traced: they meet the first wall, for all items of a point alike.
 *
 * The origin is lifted off its face by 2 delta towards the antenna (see common/bvh.h), so that
 * its own face and coincident ones are never hit. */
#include "common/width.h"
#include "common/bvh.h"

#if !defined(CLR_GROUP) || !defined(CLR_BUNDLE_GROUPS)
#error "CLR_GROUP (antennas of a group), CLR_BUNDLE_GROUPS (groups of a bundle) are missing"
#endif
#if CLR_GROUP != 8 || CLR_BUNDLE_GROUPS != 8
#error "the rays of a group are held in float8 and those of a bundle in the bits of a ulong"
#endif

/* An antenna is a sphere of this radius, or a point (0). Where the plane of the point's face cuts a
 * sphere, rays on each side go to the middle of the part on theirs: how far that is above the centre. */
static inline realw lift_of(const realw above, const float radius) {
    return above < radius ? 0.5f * (radius - above) : (realw)(0.0f);
}

#if CLR_WIDE

/* A bundle of antennas, as BUNDLE in clradar/tracing/antenna_packets.py. */
typedef struct {
    int n_groups;                                     /* in use */
    int unused[7];
    int first[CLR_BUNDLE_GROUPS];                     /* antenna of a group of successive ones, else -1 */
    float low[3][CLR_BUNDLE_GROUPS];                  /* corner of each group's box, metres */
    float high[3][CLR_BUNDLE_GROUPS];
    float position[3][CLR_BUNDLE_GROUPS][CLR_GROUP];  /* metres; the last of a group is repeated */
    int antenna[CLR_BUNDLE_GROUPS][CLR_GROUP];        /* its index; -1: padding */
} bundle;

/* Rays to the antennas of a bundle go along a main axis, to one side. Their slopes along the two others: */
typedef struct {
    float8 a_middle, a_half, b_middle, b_half; /* of each group */
} shafts;

static inline float most8(float8 v) {
    return -least8(-v);
}

/* A ray d passes inside an edge of a triangle where d.q >= -error; so for 8 triangles, the slack being
 * the error for the longest d of the shaft, whose component along the main axis is `sense`. */
typedef struct {
    float8 x, y, x_size, y_size, along;
} edge8;

static inline edge8 edge_of(const float8 x, const float8 y, const float8 z, const float8 slack,
                            const float sense) {
    edge8 e;
    e.x = x;
    e.y = y;
    e.x_size = absolute_pack(x);
    e.y_size = absolute_pack(y);
    e.along = fused_pack(z, (float8)(sense), slack);
    return e;
}

/* Slopes of the rays of a shaft: the middle, and how far to either side. */
typedef struct {
    float a_centre, a_extent, b_centre, b_extent;
} slopes;

/* The most that d.q + slack reaches for any d of a shaft. */
static inline float8 most_of(const edge8 e, const slopes s) {
    return fused_pack(e.x_size, s.a_extent,
                  fused_pack(e.y_size, s.b_extent,
                         fused_pack(e.x, s.a_centre, fused_pack(e.y, s.b_centre, e.along))));
}

/* A search for the rays of a bundle that something blocks.
 *
 * `main` is the axis that all rays go along, `sense` to which side, `farthest` how far, and `slant` is more
 * than how much longer a ray is than that; `o` is the origin along the second, third and main axis.
 * direction (3, 8): unit directions by axis and group; distance (8): to the antennas. */
typedef struct {
    __global const float *nodes, *triangles;
    float3 from, o;
    int main, second, third, n_used;
    float sense, farthest, slant;
    const shafts *shaft;
    const float8 *direction, *distance;
} search;

/* The boxes of a node's children relative to the origin and along the axes of a search. */
typedef struct {
    float8 start, end, a_from, a_to, b_from, b_to;
} boxes8;

static inline boxes8 boxes_of(const search *s, __global const float *node) {
    const int near_row = 8 * s->main + (s->sense > 0.0f ? NODE_LOW : NODE_HIGH);
    const int far_row = 8 * s->main + (s->sense > 0.0f ? NODE_HIGH : NODE_LOW);
    boxes8 box;
    box.start = larger8((LOAD8(node + near_row) - s->o.z) * s->sense, (float8)(0.0f));
    box.end = smaller8((LOAD8(node + far_row) - s->o.z) * s->sense, (float8)(s->farthest));
    box.a_from = LOAD8(node + 8 * s->second + NODE_LOW) - s->o.x;
    box.a_to = LOAD8(node + 8 * s->second + NODE_HIGH) - s->o.x;
    box.b_from = LOAD8(node + 8 * s->third + NODE_LOW) - s->o.y;
    box.b_to = LOAD8(node + 8 * s->third + NODE_HIGH) - s->o.y;
    return box;
}

/* Boxes that a shaft meets. */
static inline int8 met_in(const boxes8 box, const slopes of) {
    const float a_low = of.a_centre - of.a_extent, a_high = of.a_centre + of.a_extent;
    const float b_low = of.b_centre - of.b_extent, b_high = of.b_centre + of.b_extent;
    return (box.start <= box.end) & (smaller8(box.start * a_low, box.end * a_low) <= box.a_to) &
           (larger8(box.start * a_high, box.end * a_high) >= box.a_from) &
           (smaller8(box.start * b_low, box.end * b_low) <= box.b_to) &
           (larger8(box.start * b_high, box.end * b_high) >= box.b_from);
}

/* Boxes that are much smaller than the shaft is wide. */
static inline int8 small_in(const boxes8 box, const slopes of, const float times) {
    return box.start * (2.0f * (of.a_extent + of.b_extent)) >
           ((box.a_to - box.a_from) + (box.b_to - box.b_from)) * times;
}

/* A block of triangles relative to the origin of a search, and its edges for any shaft of it. */
typedef struct {
    __global const float *rows;
    block_tests tests;
    edge8 u, v, w, facing;
} shaft_block;

static inline shaft_block shaft_block_from(const search *s, const int child) {
    shaft_block block;
    block.rows = s->triangles + (size_t)-(child + 1) * BLOCK_FLOATS;
    const block_tests b = block_from(block.rows, s->o, s->second, s->third, s->main);
    block.u = edge_of(b.q2x, b.q2y, b.q2z, s->slant * b.eu, s->sense);
    block.v = edge_of(b.q1x, b.q1y, b.q1z, s->slant * b.ev, s->sense);
    block.w = edge_of(b.nx - b.q2x - b.q1x, b.ny - b.q2y - b.q1y, b.nz - b.q2z - b.q1z,
                      s->slant * b.ew, s->sense);
    block.facing = edge_of(b.nx, b.ny, b.nz, (float8)(0.0f), s->sense);
    block.tests = b;
    return block;
}

/* Triangles inside all edges of which some ray of a shaft may pass. */
static inline int8 edges_met(const shaft_block *block, const slopes of) {
    return (most_of(block->u, of) >= 0.0f) & (most_of(block->v, of) >= 0.0f) &
           (most_of(block->w, of) >= 0.0f);
}

/* Triangles that may block a ray of a shaft. */
static inline int8 may_block(const shaft_block *block, const slopes of) {
    return edges_met(block, of) & (most_of(block->facing, of) > 0.0f) &
           (block->tests.height > 0.0f);
}

/* The rays of `open` (bit 8 g + lane) that no triangle of a block stops. `pairs` are to be tested: bit 8 g + t for
 * group g and triangle t. */
static inline ulong left_open(const search *s, const shaft_block *block, ulong pairs, ulong open) {
    const float8 *along0 = s->direction + 8 * s->main, *along1 = s->direction + 8 * s->second,
                 *along2 = s->direction + 8 * s->third;
    const block_tests *b = &block->tests;
    const float8 twice_eu = 2.0f * b->eu, twice_ev = 2.0f * b->ev, twice_ew = 2.0f * b->ew;
    const float8 sum_error = b->ew + b->eu + b->ev;
    for (; pairs; pairs &= pairs - 1) {
        const int pair = lowest_long(pairs), g = pair >> 3, lane = pair & 7;
        const float *q2 = (const float *)&b->q2x + lane;
        const float *q1 = (const float *)&b->q1x + lane;
        const float *n = (const float *)&b->nx + lane;
        const float8 d0 = along0[g], d1 = along1[g], d2 = along2[g];
        /* Each with its error added: inside an edge where not negative. */
        const float8 u = fused_pack(d1, q2[0], fused_pack(d2, q2[8], fused_pack(d0, q2[16], LANE(b->eu, lane))));
        const float8 v = fused_pack(d1, q1[0], fused_pack(d2, q1[8], fused_pack(d0, q1[16], LANE(b->ev, lane))));
        const float8 size = fused_pack(d1, n[0], fused_pack(d2, n[8], d0 * n[16]));
        const float8 w = size + LANE(sum_error, lane) - (u + v);
        int8 blocked = (u >= 0.0f) & (v >= 0.0f) & (w >= 0.0f) & (size > LANE(b->edge_on, lane)) &
                       (LANE(b->height, lane) < s->distance[g] * size);
        const int8 unsure =
            blocked & ((u <= LANE(twice_eu, lane)) | (v <= LANE(twice_ev, lane)) | (w <= LANE(twice_ew, lane)));
        if (any8(unsure)) {
            const int8 inside =
                inside_triangle(block->rows + lane, s->from, s->direction[g], s->direction[8 + g],
                                s->direction[16 + g]);
            blocked = unsure ? inside : blocked;
        }
        open &= ~((ulong)lanes8(blocked) << 8 * g);
    }
    return open;
}

static inline slopes of_group(const search *s, const int g) {
    const float *group = (const float *)s->shaft + g;
    return (slopes){group[0], group[8], group[16], group[24]};
}

static inline slopes of_ray(const search *s, const int ray) {
    const float inverse = s->sense / ((const float *)(s->direction + 8 * s->main))[ray];
    const float a = ((const float *)(s->direction + 8 * s->second))[ray] * inverse;
    const float b = ((const float *)(s->direction + 8 * s->third))[ray] * inverse;
    return (slopes){a, 0x1p-21f * absolute(a), b, 0x1p-21f * absolute(b)};
}

/* The shaft of a bundle saves work as long as boxes are wider than it. It meets many boxes that are much
 * narrower and that none of its rays meets: below those each group is traced by itself, and further down each ray. */
#define WIDE_OF_BUNDLE 16.0f /* a shaft is too wide at this many times the width of a box */
#define WIDE_OF_GROUP 1.0f   /* and that of a group */
#define RAYS 8               /* "who": group g, or ray who - RAYS */

/* Depth-first traversal for each group by itself, from those children of a node whose bits are set. */
__attribute__((noinline)) static ulong unblocked_apart(const search *s, const int start,
                                                       const uint lanes, ulong open) {
    /* A node leaves behind at most a group and its 8 rays. */
    int stack[9 * CLR_STACK];
    uchar waiting[9 * CLR_STACK], whose[9 * CLR_STACK];
    for (int g = 0; g < s->n_used; ++g) {
        if (!(open >> 8 * g & 0xff)) continue;
        int top = 0, child = start, who = g;
        uint within = lanes;
        for (;;) {
            const slopes of = who < RAYS ? of_group(s, who) : of_ray(s, who - RAYS);
            if (child >= 0) {
                const boxes8 box = boxes_of(s, s->nodes + (size_t)child * NODE_FLOATS);
                uint hit = lanes8(met_in(box, of)) & within;
                const uint small =
                    who < RAYS ? hit & lanes8(small_in(box, of, WIDE_OF_GROUP)) : 0;
                if (small) {
                    for (uint rest = (uint)(open >> 8 * g & 0xff); rest; rest &= rest - 1) {
                        const int ray = 8 * g + lowest(rest);
                        const uint some = small & lanes8(met_in(box, of_ray(s, ray)));
                        stack[top] = child;
                        whose[top] = (uchar)(RAYS + ray);
                        waiting[top] = (uchar)some;
                        top += some != 0;
                    }
                    hit &= ~small;
                }
                stack[top] = child;
                whose[top] = (uchar)who;
                waiting[top] = (uchar)hit;
                top += hit != 0;
                within = 0xff;
            } else {
                const shaft_block block = shaft_block_from(s, child);
                const ulong pairs = (ulong)lanes8(may_block(&block, of)) << 8 * g;
                if (pairs) open = left_open(s, &block, pairs, open);
            }
            /* Drop nodes of rays that are blocked by now. */
            for (; top; --top) {
                who = whose[top - 1];
                if (who < RAYS ? open >> 8 * g & 0xff : open >> (who - RAYS) & 1) break;
            }
            if (top == 0) break;
            const uint left = waiting[top - 1], rest = left & (left - 1);
            __global const float *family = s->nodes + (size_t)stack[top - 1] * NODE_FLOATS;
            child = as_int(family[lowest(left)]);
            if (rest) fetch_child(s->nodes, s->triangles, as_int(family[lowest(rest)]));
            waiting[top - 1] = (uchar)rest;
            top -= rest == 0;
        }
    }
    return open;
}

/* Lanes whose bits are set. */
static inline int8 lanes_of(const uint bits) {
    return ((int8)((int)bits) & (int8)(1, 2, 4, 8, 16, 32, 64, 128)) != 0;
}

/* The lane of `bits` whose value is the least. */
static inline uint least_of(const uint bits, const float8 value) {
    if (!(bits & (bits - 1))) return bits;
    const float8 among = lanes_of(bits) ? value : (float8)(FLT_MAX);
    const uint least = lanes8(among == least8(among));
    return least & -least;
}

/* Groups with a ray in `open`, as bits. */
static inline uint groups_of(ulong open) {
    open |= open >> 4;
    open |= open >> 2;
    open |= open >> 1;
    return (uint)((open & 0x0101010101010101ul) * 0x0102040810204080ul >> 56);
}

/* Least and most of the slopes of some groups as middle and half the width, wider by what rounding may take. */
static inline void around(const int8 groups, const float8 middle, const float8 spread,
                          float *centre, float *extent) {
    const float low = least8(groups ? middle - spread : (float8)(FLT_MAX));
    const float high = -least8(groups ? -(middle + spread) : (float8)(FLT_MAX));
    *centre = 0.5f * (low + high);
    *extent = 0.5f * (high - low) + 0x1p-20f * larger(absolute(low), absolute(high));
}

/* Slopes of the rays of some groups together. */
static inline slopes of_groups(const search *s, const uint groups) {
    const int8 lanes = lanes_of(groups);
    slopes all;
    around(lanes, s->shaft->a_middle, s->shaft->a_half, &all.a_centre, &all.a_extent);
    around(lanes, s->shaft->b_middle, s->shaft->b_half, &all.b_centre, &all.b_extent);
    return all;
}

/* The rays of `open` (bit 8 g + lane) that nothing blocks. Children that end near are visited first: what blocks a
 * ray there saves what is behind. The shaft is that around the groups that have a ray left. */
static inline ulong unblocked(const search *s, ulong open) {
    uint groups = groups_of(open);
    slopes all = of_groups(s, groups);
    /* Nodes, which of their children are still to be visited, where they end, and the groups that they were tested
     * for. */
    int stack[CLR_STACK];
    uint waiting[CLR_STACK], tested[CLR_STACK];
    float8 end[CLR_STACK];
    int top = 0;
    int child = 0;
    for (;;) {
        const ulong before = open;
        if (child >= 0) {
            const boxes8 box = boxes_of(s, s->nodes + (size_t)child * NODE_FLOATS);
            const int8 met = met_in(box, all);
            uint hit = lanes8(met);
            const uint small = lanes8(met & small_in(box, all, WIDE_OF_BUNDLE));
            if (small) {
                open = unblocked_apart(s, child, small, open);
                hit &= ~small;
            }
            stack[top] = child;
            waiting[top] = hit;
            tested[top] = groups;
            end[top] = box.end;
            top += hit != 0;
        } else {
            const shaft_block block = shaft_block_from(s, child);
            const int8 hit = may_block(&block, all);
            if (any8(hit)) {
                ulong pairs = 0;
                for (int g = 0; g < s->n_used; ++g) {
                    if (!(open >> 8 * g & 0xff)) continue;
                    const slopes of = of_group(s, g);
                    pairs |= (ulong)lanes8(hit & edges_met(&block, of)) << 8 * g;
                }
                open = left_open(s, &block, pairs, open);
            }
        }
        if (open != before) {
            if (!open) return 0;
            const uint left = groups_of(open);
            if (left != groups) all = of_groups(s, left);
            groups = left;
        }
        for (; top && tested[top - 1] != groups; top -= waiting[top - 1] == 0) {
            const boxes8 box = boxes_of(s, s->nodes + (size_t)stack[top - 1] * NODE_FLOATS);
            waiting[top - 1] &= lanes8(met_in(box, all));
            tested[top - 1] = groups;
        }
        if (top == 0) return open;
        __global const float *family = s->nodes + (size_t)stack[top - 1] * NODE_FLOATS;
        const uint left = waiting[top - 1], first = least_of(left, end[top - 1]), rest = left & ~first;
        child = as_int(family[lowest(first)]);
        if (rest) {
            const uint next = least_of(rest, end[top - 1]);
            fetch_child(s->nodes, s->triangles, as_int(family[lowest(next)]));
        }
        waiting[top - 1] = rest;
        top -= rest == 0;
    }
}

/* Interval product: least and most of [low, high] x [c, d], c, d > 0, wider by what rounding may take. */
static inline void stretch(const float8 low, const float8 high, const float8 c, const float8 d,
                           float8 *middle, float8 *spread) {
    const float8 least_8 = smaller8(low * c, low * d), most_8 = larger8(high * c, high * d);
    const float8 size = larger8(larger8(least_8, -least_8), larger8(most_8, -most_8));
    *middle = 0.5f * (least_8 + most_8);
    *spread = 0.5f * (most_8 - least_8) + 0x1p-20f * size;
}

/* Directions and distances from o to the antennas of group g; returns those on this side of the face, as bits. */
static inline uint aim(__global const bundle *of, const int g, const float3 p, const float3 o,
                       const float3 normal, const float side, const float radius,
                       float8 *direction, float8 *distance) {
    const float8 ax = LOAD8(of->position[0][g]), ay = LOAD8(of->position[1][g]),
                 az = LOAD8(of->position[2][g]);
    const int8 antenna = LOAD8I(of->antenna[g]);
    const float8 above = ((ax - p.x) * normal.x + (ay - p.y) * normal.y + (az - p.z) * normal.z) * side;
    const float8 lift = lift_of(above, radius) * side;
    const float8 dx = ax - o.x + lift * normal.x, dy = ay - o.y + lift * normal.y,
                 dz = az - o.z + lift * normal.z;
    distance[g] = sqrt(dx * dx + dy * dy + dz * dz);
    const float8 inverse = 1.0f / distance[g];
    direction[g] = dx * inverse;
    direction[8 + g] = dy * inverse;
    direction[16 + g] = dz * inverse;
    return lanes8((above > -radius) & (antenna >= 0));
}

/* Set the bits of the antennas of a bundle. */
static inline void set_visible(__global const bundle *of, const ulong visible, __global uchar *out) {
    for (int g = 0; g < of->n_groups; ++g) {
        uint bits = (uint)(visible >> 8 * g & 0xff);
        if (!bits) continue;
        const int first = of->first[g];
        if (first >= 0) {
            bits <<= first & 7;
            out[first >> 3] |= (uchar)bits;
            if (bits >> 8) out[(first >> 3) + 1] |= (uchar)(bits >> 8);
        } else {
            for (; bits; bits &= bits - 1) {
                const int antenna = of->antenna[g][lowest(bits)];
                out[antenna >> 3] |= (uchar)(1 << (antenna & 7));
            }
        }
    }
}

/* The rays of `open` that nothing blocks, one after the other: for antennas too close to make a shaft. */
static inline ulong unblocked_one_by_one(__global const float *nodes, __global const float *triangles,
                                         const float3 o, const float8 *direction,
                                         const float8 *distance, ulong open) {
    for (ulong rest = open; rest; rest &= rest - 1) {
        const int ray = lowest_long(rest);
        const float *x = (const float *)direction + ray;
        const float3 d = (float3)(x[0], x[64], x[128]);
        const float far = ((const float *)distance)[ray];
        if (intersect(nodes, triangles, o, d, far, true).triangle >= 0) open &= ~(1ul << ray);
    }
    return open;
}

/* Find the visible antennas of a point, one bundle after the other. */
static inline void find_visible(const float3 p, const float3 normal, const float delta,
                                const float radius, __global const float *nodes,
                                __global const float *triangles, __global const float *header,
                                __global uchar *out) {
    const int n_bundles = as_int(header[0]);
    __global const bundle *of = (__global const bundle *)(header + 8);
    __global const float *bounds = nodes + NODE_BOUNDS;
    const int inner = -(int)nodes[NODE_OUTWARD];
    bool tested = false, inside = false;
    for (int b = 0; b < n_bundles; ++b, ++of) {
        const int n_used = of->n_groups;
        float8 direction[3 * CLR_BUNDLE_GROUPS], distance[CLR_BUNDLE_GROUPS];
        const float8 lx = LOAD8(of->low[0]) - radius;
        const float8 ly = LOAD8(of->low[1]) - radius;
        const float8 lz = LOAD8(of->low[2]) - radius;
        const float8 hx = LOAD8(of->high[0]) + radius;
        const float8 hy = LOAD8(of->high[1]) + radius;
        const float8 hz = LOAD8(of->high[2]) + radius;
        /* Twice the height above the face of the middle of each box, and by how much its corners differ. */
        const float8 middle = (lx + hx - 2.0f * p.x) * normal.x + (ly + hy - 2.0f * p.y) * normal.y +
                              (lz + hz - 2.0f * p.z) * normal.z;
        const float8 spread = (hx - lx) * absolute(normal.x) + (hy - ly) * absolute(normal.y) +
                              (hz - lz) * absolute(normal.z) + 2.0f * delta;
        /* The face is two-sided; antennas on either side of its plane need their own origin. */
        for (int side = -1; side <= 1; side += 2) {
            uint possible = lanes8(middle * (float)side > -spread) & ((1u << n_used) - 1u);
            if (!possible) continue;
            const float3 o = p + normal * ((float)side * 2.0f * delta);
            if (side == inner) {
                const int8 outside = (lx > bounds[3]) | (ly > bounds[4]) | (lz > bounds[5]) |
                                    (hx < bounds[0]) | (hy < bounds[1]) | (hz < bounds[2]);
                if (!(possible & ~lanes8(outside))) {
                    if (!tested) inside = inside_closed(nodes, triangles, o, normal * (float)side, delta);
                    tested = true;
                    if (inside) continue;
                }
            }
            ulong open = 0;
            float8 most_distance = (float8)(0.0f);
            for (int g = 0; g < n_used; ++g) {
                if (!(possible & 1u << g)) continue;
                open |= (ulong)aim(of, g, p, o, normal, (float)side, radius, direction, distance) << 8 * g;
                most_distance = larger8(most_distance, distance[g]);
            }
            if (!open) continue;

            /* The main axis is that along which the middle of the bundle is farthest. */
            const float8 low[3] = {lx - o.x, ly - o.y, lz - o.z};
            const float8 high[3] = {hx - o.x, hy - o.y, hz - o.z};
            int main = 0;
            float best = -1.0f, sense = 1.0f;
            for (int k = 0; k < 3; ++k) {
                const float c = low[k].s0 + high[k].s0;
                if (absolute(c) > best) {
                    best = absolute(c);
                    main = k;
                    sense = c < 0.0f ? -1.0f : 1.0f;
                }
            }
            const int second = main == 2 ? 0 : main + 1, third = main == 0 ? 2 : main - 1;
            const float8 nearest = sense > 0.0f ? low[main] : -high[main];
            const float8 farthest = sense > 0.0f ? high[main] : -low[main];
            const float shortest = least8(nearest), longest = most8(farthest);
            if (shortest * 8.0f > most8(most_distance)) {
                const float8 c = 1.0f / farthest, d = 1.0f / nearest;
                shafts shaft;
                stretch(low[second], high[second], c, d, &shaft.a_middle, &shaft.a_half);
                stretch(low[third], high[third], c, d, &shaft.b_middle, &shaft.b_half);
                const float at[3] = {o.x, o.y, o.z};
                const search what = {nodes, triangles, o, (float3)(at[second], at[third], at[main]),
                                     main, second, third, n_used, sense, longest * (1.0f + 0x1p-20f),
                                     32.0f, &shaft, direction, distance};
                open = unblocked(&what, open);
            } else {
                open = unblocked_one_by_one(nodes, triangles, o, direction, distance, open);
            }
            set_visible(of, open, out);
        }
    }
}

#else

/* Set the bits of a group of 8 antennas, one ray after the other. */
static inline void find_visible_of_group(const float3 p, const float3 normal, const uint n_antennas,
                                         const uint stride, const uint group, const float delta,
                                         const float radius, __global const float *nodes,
                                         __global const float *triangles,
                                         __global const float *antennas, __global uchar *out) {
    uint bits = 0;
    for (uint b = 0; b < CLR_GROUP && group * CLR_GROUP + b < n_antennas; ++b) {
        __global const float *at = antennas + group * CLR_GROUP + b;
        const float3 antenna = (float3)(at[0], at[stride], at[2 * stride]);
        for (int side = -1; side <= 1; side += 2) {
            const float above = dot3(antenna - p, normal) * (float)side;
            if (!(above > -radius)) continue;
            const float3 o = p + normal * ((float)side * 2.0f * delta);
            const float3 d = antenna - o + normal * (lift_of(above, radius) * (float)side);
            const float distance = length3(d);
            if (intersect(nodes, triangles, o, d * (1.0f / distance), distance, true).triangle < 0)
                bits |= 1u << b;
        }
    }
    out[group] = (uchar)bits;
}

#endif

/* Find the visible antennas of this item's point. */
static inline void find(const uint n_samples, const uint n_antennas, const uint n_groups,
                        const float delta, const float radius, __global const float *nodes,
                        __global const float *triangles, __global const float *antennas,
                        __global const float *point, __global const float *geometric,
                        __global uchar *visible) {
    const uint group = (uint)get_global_id(0), i = (uint)get_global_id(1);
    if (i >= n_samples || group >= n_groups) return;
    const float3 p = load3(point + 3 * (size_t)i), normal = load3(geometric + 3 * (size_t)i);
    const uint stride = n_groups * CLR_GROUP;
    __global uchar *out = visible + (size_t)i * n_groups;
#if CLR_WIDE
    for (uint g = 0; g < n_groups; ++g) out[g] = 0;
    find_visible(p, normal, delta, radius, nodes, triangles, antennas + 3 * stride, out);
#else
    find_visible_of_group(p, normal, n_antennas, stride, group, delta, radius, nodes, triangles, antennas, out);
#endif
}

/* nodes, triangles  see common/bvh.h
 * tx        float (3, n_groups * 8)  antennas, metres; padded with copies of the last; then an int, the
 *           number of bundles, 7 unused words, and the bundles
 * point     float (n_samples, 3)     metres
 * geometric float (n_samples, 3)     unit face normals
 * visible   uchar (n_samples, n_groups)  out: bit b of group g is set if antenna 8 g + b is visible */
__kernel void visible_antennas(const uint n_samples, const uint n_tx, const uint n_groups,
                               const float delta, __global const float *nodes,
                               __global const float *triangles, __global const float *tx,
                               __global const float *point, __global const float *geometric,
                               __global uchar *visible) {
    find(n_samples, n_tx, n_groups, delta, 0.0f, nodes, triangles, tx, point, geometric, visible);
}

/* The same of receivers, which are spheres. */
__kernel void visible_spheres(const uint n_samples, const uint n_rx, const uint n_groups,
                              const float delta, const float radius, __global const float *nodes,
                              __global const float *triangles, __global const float *rx,
                              __global const float *point, __global const float *geometric,
                              __global uchar *visible) {
    find(n_samples, n_rx, n_groups, delta, radius, nodes, triangles, rx, point, geometric, visible);
}

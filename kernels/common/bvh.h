/* Bounding volume hierarchy: layout shared by all traversals.
 *
 * nodes: float (n_nodes, 16). A node holds the boxes of its two children, each padded by the host by
 * the error bound delta below, so that no box test misses what an exact one finds:
 *     [0..2] left lo   [3] left child, int bits
 *     [4..6] left hi   [7] right child, int bits
 *     [8..10] right lo  [11] unused
 *     [12..14] right hi [15] unused
 * A child >= 0 is a node; a child < 0 is a leaf: -(child + 1) = first * 16 + count.
 *
 * triangles: float (n_triangles, 16), in leaf order, metres:
 *     [0..2] v0         [3] face, int bits
 *     [4..6] e1 = v1-v0 [7] |e1|
 *     [8..10] e2 = v2-v0 [11] |e2|
 *     [12..14] N = e1 x e2 (from float64) [15] 2^-21 |N|
 *
 * Triangle test (Moeller and Trumbore 1997, written for many directions from one origin o): with
 * T = v0 - o, u |d.N| = +-d.(e2 x T), v |d.N| = +-d.(T x e1), t = T.N / d.N. In float32, with unit
 * roundoff w = 2^-24, the first two are wrong by at most 8 w |T| |e2| and 8 w |T| |e1| (2 w from the
 * roundings of T and e2, 2 w in each component of the cross product, 1.16 times as long as the product
 * of the lengths, and 3 w in the dot product), d by 3 w, and |d.N| by 4 w |N|. Within 12 w |T|_1 |e2|,
 * 12 w |T|_1 |e1| and, at the third edge, their sum and 8 w |N|, about one hit in a thousand,
 * float32 cannot tell the side of an edge: inside_triangle() does, in doubled precision. There only
 * the roundings of e1 and e2 count, which move an edge by less than 2 w of its length: neighbours
 * overlap by about 1e-10 m instead of leaving a gap. A triangle that is seen edge on within rounding
 * (|d.N| <= 2^-21 |N|) is no hit; its neighbours are.
 *
 * delta = 32 w M, with M the largest distance of any vertex or antenna from the origin, bounds all of
 * this and the rounding of points on the surface. Boxes are padded by it, and rays leave a face from
 * 2 delta above it. */
#ifndef CLR_STACK
#error "CLR_STACK (entries of the traversal stack: the depth of the tree, from the host) is missing"
#endif

#include "common/dual.h"
#include "common/vector.h"

#define NODE_FLOATS 16
#define TRIANGLE_FLOATS 16

/* Error bound of the triangle test relative to an edge's length: 12 w |T|_1. */
static inline float edge_error(const float3 to) {
    return 0x1.8p-21f * (absolute(to.x) + absolute(to.y) + absolute(to.z));
}

/* Component of the cross product of (ay, az) and (by, bz). */
static inline dual cross_component(realw ay, realw az, realw by, realw bz) {
    return dual_add(exact_product(ay, bz), dual_negative(exact_product(az, by)));
}

static inline dual dual_dot(dual ax, dual ay, dual az, dual bx, dual by, dual bz) {
    return dual_add(dual_add(dual_product(ax, bx), dual_product(ay, by)), dual_product(az, bz));
}

/* Whether the line o + t d passes through the triangle, decided in doubled precision:
 * u |d.N| = +-T.(d x e2), v |d.N| = +-T.(e1 x d). */
static inline intw inside_triangle(__global const float *triangle, const float3 o, const realw dx,
                                   const realw dy, const realw dz) {
    const float3 v0 = load3(triangle), e1 = load3(triangle + 4), e2 = load3(triangle + 8);
    const float3 n = load3(triangle + 12);
    const dual tx = two_sum((realw)(v0.x), (realw)(-o.x));
    const dual ty = two_sum((realw)(v0.y), (realw)(-o.y));
    const dual tz = two_sum((realw)(v0.z), (realw)(-o.z));
    const dual u =
        dual_dot(tx, ty, tz, cross_component(dy, dz, (realw)(e2.y), (realw)(e2.z)),
                 cross_component(dz, dx, (realw)(e2.z), (realw)(e2.x)),
                 cross_component(dx, dy, (realw)(e2.x), (realw)(e2.y)));
    const dual v =
        dual_dot(tx, ty, tz, cross_component((realw)(e1.y), (realw)(e1.z), dy, dz),
                 cross_component((realw)(e1.z), (realw)(e1.x), dz, dx),
                 cross_component((realw)(e1.x), (realw)(e1.y), dx, dy));
    const dual size = dual_add(dual_add(exact_product(dx, (realw)(n.x)),
                                        exact_product(dy, (realw)(n.y))),
                               exact_product(dz, (realw)(n.z)));
    const dual rest = dual_add(size, dual_negative(dual_add(u, v)));
    const realw sign = size.hi < 0.0f ? (realw)(-1.0f) : (realw)(1.0f);
    const float longest = larger(triangle[7], triangle[11]);
    const float slack = 0x1p-22f * longest * longest;
    return (u.hi * sign >= -slack) & (v.hi * sign >= -slack) & (rest.hi * sign >= -slack);
}

/* 1 / d, kept finite so that no product with it is NaN. */
static inline float safe_inverse(float d) {
    return 1.0f / (d < 1e-18f && d > -1e-18f ? 1e-18f : d);
}

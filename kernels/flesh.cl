/* The hand's flesh: signed distance to a smooth union of round cones, and its gradient. The smooth minimum is the
 * quadratic polynomial one of I. Quilez (iquilezles.org/articles/smin), the cone his sdRoundCone.
 *
 * Item = CLR_WIDTH points. A cone is a record of ten floats, in the order palm, then each digit's root and end:
 *     begin (3), unit vector to the end (3), length, radius at the begin, sine and tangent of the flank's slope
 * metres, in a frame whose origin is the middle of the hand. A point's distance is evaluated from the cones near its
 * cell alone, which are bits in `palm_near` and `digits_near`. Each lane applies the operations of its own cones and
 * no others, so that its result does not depend on the other lanes of the item. */
#if !defined(CLR_PALM) || !defined(CLR_ROOT) || !defined(CLR_END) || !defined(CLR_NODES)
#error "CLR_PALM, CLR_ROOT, CLR_END (cones) and CLR_NODES (nodes along an edge of a cell) are missing"
#endif
#if !defined(CLR_PALM_BLEND_M) || !defined(CLR_ROOT_BLEND_M) || !defined(CLR_DIGIT_BLEND_M) || \
    !defined(CLR_CONTACT_BLEND_M) || !defined(CLR_CUT_BLEND_M)
#error "CLR_PALM_BLEND_M, CLR_ROOT_BLEND_M, CLR_DIGIT_BLEND_M, CLR_CONTACT_BLEND_M or CLR_CUT_BLEND_M is missing"
#endif

#include "common/width.h"

#define DIGITS 5
#define DIGIT (CLR_ROOT + CLR_END)
#define CONES (CLR_PALM + DIGITS * DIGIT)
#if CLR_PALM > 32 || DIGITS * DIGIT > 32
#error "CLR_PALM and 5 (CLR_ROOT + CLR_END) must not be more than the 32 bits of a word"
#endif
#define CONE_FLOATS 10
#define PER_CELL (CLR_NODES * CLR_NODES * CLR_NODES)
#define CELL_GROUPS (PER_CELL / CLR_WIDTH)
#define BITS(count) ((1u << (count)) - 1u)

/* More than the diameter of a hand: the distance to an empty union. */
#define FAR_M 10.0f

#define ROOT_OF_3 1.7320508f

typedef struct {
    realw x, y, z;
} positions;

typedef struct {
    realw distance, x, y, z;
} distance_gradient;

typedef union {
    intw all;
    int lane[CLR_WIDTH];
} int_lanes;

typedef union {
    realw all;
    float lane[CLR_WIDTH];
} real_lanes;

/* Bit masks of the cones near the points of an item: of any lane, and of each lane. */
typedef struct {
    uint any_palm, any_digits;
    intw palm, digits;
} near_cones;

static inline distance_gradient cone_distance(__global const float *cone, const positions p) {
    const realw from_x = p.x - cone[0], from_y = p.y - cone[1], from_z = p.z - cone[2];
    const float axis_x = cone[3], axis_y = cone[4], axis_z = cone[5];
    const float length = cone[6], radius = cone[7], sine = cone[8], tangent = cone[9];
    /* Along the axis, and away from it. */
    const realw t = from_x * axis_x + from_y * axis_y + from_z * axis_z;
    const realw away_x = from_x - t * axis_x, away_y = from_y - t * axis_y, away_z = from_z - t * axis_z;
    const realw away2 = away_x * away_x + away_y * away_y + away_z * away_z;
    /* Projection of the point onto the axis along the normal of the cone's flank: the centre of the nearest of the
     * spheres that sweep out the cone. To first order it does not change with the point, hence the gradient. */
    const realw projected = t - sqrt(away2) * tangent;
    const realw foot = lesser(greater(projected, (realw)(0.0f)), (realw)(length));
    const realw beyond = t - foot;
    const realw from_centre = sqrt(beyond * beyond + away2);
    const realw inverse = 1.0f / greater(from_centre, (realw)(1e-30f));
    distance_gradient s;
    s.distance = from_centre - (radius - sine * foot);
    s.x = (away_x + beyond * axis_x) * inverse;
    s.y = (away_y + beyond * axis_y) * inverse;
    s.z = (away_z + beyond * axis_z) * inverse;
    return s;
}

/* Quadratic smooth minimum: differs from the minimum where |a - b| < blend, by at most blend / 4. */
static inline distance_gradient blended(const distance_gradient a, const distance_gradient b, const float blend) {
    const realw gap = a.distance - b.distance;
    const realw overlap = greater(blend - choose(gap < 0.0f, -gap, gap), (realw)(0.0f));
    const realw share = overlap * (0.5f / blend);
    const realw of_b = choose(gap <= 0.0f, share, 1.0f - share);
    distance_gradient s;
    s.distance = choose(gap <= 0.0f, a.distance, b.distance) - overlap * overlap * (0.25f / blend);
    s.x = a.x + of_b * (b.x - a.x);
    s.y = a.y + of_b * (b.y - a.y);
    s.z = a.z + of_b * (b.z - a.z);
    return s;
}

static inline distance_gradient chosen(const intw condition, const distance_gradient yes, const distance_gradient no) {
    distance_gradient s;
    s.distance = choose(condition, yes.distance, no.distance);
    s.x = choose(condition, yes.x, no.x);
    s.y = choose(condition, yes.y, no.y);
    s.z = choose(condition, yes.z, no.z);
    return s;
}

static inline distance_gradient opposite(distance_gradient s) {
    s.distance = -s.distance;
    s.x = -s.x;
    s.y = -s.y;
    s.z = -s.z;
    return s;
}

static inline distance_gradient nothing_near(void) {
    distance_gradient s;
    s.distance = FAR_M;
    s.x = s.y = s.z = 0.0f;
    return s;
}

/* Smooth union of `into` with the cones whose bits are set, in their order. */
static inline distance_gradient united(distance_gradient into, __global const float *cones, uint any, const intw near,
                            const positions p, const float blend) {
    while (any) {
        const int i = lowest(any);
        any &= any - 1;
        const distance_gradient with = blended(into, cone_distance(cones + CONE_FLOATS * i, p), blend);
        into = chosen((near & (int)(1u << i)) != 0, with, into);
    }
    return into;
}

static inline distance_gradient united_palm(__global const float *cones, const near_cones near, const positions p) {
    return united(nothing_near(), cones, near.any_palm, near.palm, p, CLR_PALM_BLEND_M);
}

/* Smooth union of `into` with `count` cones of a digit, from its `first`. */
static inline distance_gradient united_digit(const distance_gradient into, __global const float *cones, const int digit,
                                  const int first, const int count, const near_cones near,
                                  const positions p) {
    const int at = DIGIT * digit + first;
    return united(into, cones + CONE_FLOATS * (CLR_PALM + at), near.any_digits >> at & BITS(count),
                  near.digits >> at, p, CLR_DIGIT_BLEND_M);
}

/* frame  float (8)  low corner of the cells (3), spacing of their nodes, unit vector along the forearm (3), and
 *                   how far along it the middle of the hand is from the plane that ends the forearm; metres */
static inline distance_gradient flesh_distance_at(__global const float *frame, __global const float *cones,
                                     const near_cones near, const positions p) {
    const distance_gradient palm = united_palm(cones, near, p);
    distance_gradient whole = palm;
    for (int digit = 0; digit < DIGITS; ++digit) {
        const distance_gradient root = united_digit(nothing_near(), cones, digit, 0, CLR_ROOT, near, p);
        const distance_gradient end = united_digit(nothing_near(), cones, digit, CLR_ROOT, CLR_END, near, p);
        const distance_gradient alone = blended(root, end, CLR_DIGIT_BLEND_M);
        const distance_gradient rooted = blended(palm, root, CLR_ROOT_BLEND_M);
        /* Only the root has the wide blend with the palm: the tip of a bent finger may touch the palm and must not
         * merge with it. The plain minimum leaves no crease, because both terms equal the root's distance where
         * they are equal. */
        const distance_gradient grown = chosen(rooted.distance <= alone.distance, rooted, alone);
        /* Each of these contains the palm, which the five blends therefore thicken evenly by 0.6 mm. */
        whole = blended(whole, grown, CLR_CONTACT_BLEND_M);
    }
    distance_gradient above;
    above.x = frame[4];
    above.y = frame[5];
    above.z = frame[6];
    above.distance = frame[7] + (p.x * frame[4] + p.y * frame[5] + p.z * frame[6]);
    return opposite(blended(opposite(whole), above, CLR_CUT_BLEND_M));
}

static inline uint cell_index(const uint x, const uint y, const uint z, const uint n_y, const uint n_z_padded) {
    return (x * n_y + y) * n_z_padded + z;
}

static inline realw held_within(const realw index, const uint n) {
    return lesser(greater(index, (realw)(0.0f)), (realw)((float)(n - 1)));
}

/* The cones near each of an item's points, from the masks of their cells. */
static inline near_cones near_points(__global const float *frame, const uint n_x, const uint n_y,
                                     const uint n_z, const uint n_z_padded,
                                     __global const uint *palm_near, __global const uint *digits_near,
                                     const positions p) {
    const float per_cell = 1.0f / (CLR_NODES * frame[3]);
    int_lanes x, y, z, palm, digits;
    x.all = TO_INTW(held_within((p.x - frame[0]) * per_cell, n_x));
    y.all = TO_INTW(held_within((p.y - frame[1]) * per_cell, n_y));
    z.all = TO_INTW(held_within((p.z - frame[2]) * per_cell, n_z));
    near_cones near;
    near.any_palm = near.any_digits = 0;
    for (int lane = 0; lane < CLR_WIDTH; ++lane) {
        const uint cell = cell_index(x.lane[lane], y.lane[lane], z.lane[lane], n_y, n_z_padded);
        near.any_palm |= palm_near[cell];
        near.any_digits |= digits_near[cell];
        palm.lane[lane] = (int)palm_near[cell];
        digits.lane[lane] = (int)digits_near[cell];
    }
    near.palm = palm.all;
    near.digits = digits.all;
    return near;
}

static inline positions load_points(__global const float *points, const uint n_padded, const uint at) {
    positions p;
    p.x = LOADW(points + at);
    p.y = LOADW(points + n_padded + at);
    p.z = LOADW(points + 2 * (size_t)n_padded + at);
    return p;
}

/* Bits of those of the `count` cones of a union that affect the distance in cells whose middles are `distance` from
 * them. */
static inline intw effective_cones(const realw *distance, const int count, const realw nearest,
                              const float blend, const float reach, const float slack) {
    realw least = distance[0];
    for (int i = 1; i < count; ++i) least = lesser(least, distance[i]);
    const intw effective = least < nearest + (blend + reach + slack);
    intw bits = 0;
    for (int i = 0; i < count; ++i) {
        const intw matters = effective & (distance[i] < least + (3.0f * blend + slack));
        bits |= matters ? (intw)((int)(1u << i)) : (intw)(0);
    }
    return bits;
}

/* The cones that affect the distance in each cell, and the distance of the cell's middle.
 *
 * A blend of radius k changes nothing where the two distances differ by k or more, and lowers a union by at most k
 * in all. So a union has no effect where it is farther than the nearest cone of all by its own k plus the radii of
 * the blends after it. Within a union a cone that is 3 k farther than the nearest acts only through a chain of cones
 * in between, each of which weakens it: measured, less than 0.1 um.
 *
 * frame        see above
 * cones        float (CONES, 10)
 * palm_near    uint (n_x, n_y, n_z_padded)   out: a bit per cone of the palm
 * digits_near  uint (n_x, n_y, n_z_padded)   out: a bit per cone of the digits
 * middle       float (n_x, n_y, n_z_padded)  out: signed distance, metres */
__kernel void flesh_cells(const uint n_x, const uint n_y, const uint n_z_padded,
                          __global const float *frame, __global const float *cones,
                          __global uint *palm_near, __global uint *digits_near,
                          __global float *middle) {
    const uint iz = (uint)get_global_id(0) * CLR_WIDTH, iy = (uint)get_global_id(1);
    const uint ix = (uint)get_global_id(2);
    if (ix >= n_x || iy >= n_y || iz >= n_z_padded) return;
    const float cell_m = CLR_NODES * frame[3];
    positions p;
    p.x = frame[0] + ((float)ix + 0.5f) * cell_m;
    p.y = frame[1] + ((float)iy + 0.5f) * cell_m;
    p.z = frame[2] + (((float)iz + LANE_INDEX) + 0.5f) * cell_m;
    realw distance[CONES];
    realw nearest = FAR_M;
    for (int i = 0; i < CONES; ++i) {
        distance[i] = cone_distance(cones + CONE_FLOATS * i, p).distance;
        nearest = lesser(nearest, distance[i]);
    }
    /* Both distances of a comparison may be off by half the diagonal of a cell. */
    const float slack = ROOT_OF_3 * cell_m;
    const float after_digit = CLR_DIGIT_BLEND_M + 2.0f * CLR_CONTACT_BLEND_M;
    const float after_root = 1.5f * CLR_ROOT_BLEND_M + after_digit;
    near_cones near;
    near.palm = effective_cones(distance, CLR_PALM, nearest, CLR_PALM_BLEND_M, after_root, slack);
    near.digits = 0;
    for (int digit = 0; digit < DIGITS; ++digit) {
        const int root = DIGIT * digit, end = root + CLR_ROOT;
        near.digits |= effective_cones(distance + CLR_PALM + root, CLR_ROOT, nearest, CLR_DIGIT_BLEND_M,
                                  after_root, slack) << root;
        near.digits |= effective_cones(distance + CLR_PALM + end, CLR_END, nearest, CLR_DIGIT_BLEND_M,
                                  after_digit, slack) << end;
    }
    near.any_palm = (uint)ANYW(near.palm);
    near.any_digits = (uint)ANYW(near.digits);
    const uint cell = cell_index(ix, iy, iz, n_y, n_z_padded);
    STOREW(AS_REALW(near.palm), (__global float *)palm_near + cell);
    STOREW(AS_REALW(near.digits), (__global float *)digits_near + cell);
    STOREW(flesh_distance_at(frame, cones, near, p).distance, middle + cell);
}

/* Signed distances at the nodes of cells, which are half a spacing inside them. The field is a lower bound of the
 * distance, so a cell whose middle is farther from the surface than from its corners contains no surface. Its nodes
 * need only a sign and get the distance of the middle.
 *
 * nodes    float (layers CLR_NODES, n_y CLR_NODES, n_z CLR_NODES)  out: metres */
__kernel void flesh_nodes(const uint layers, const uint n_y, const uint n_z, const uint n_z_padded,
                          __global const float *frame,
                          __global const float *cones, __global const uint *palm_near,
                          __global const uint *digits_near, __global const float *middle,
                          __global float *nodes) {
    const uint iz = (uint)get_global_id(0) / CELL_GROUPS, group = (uint)get_global_id(0) % CELL_GROUPS;
    const uint iy = (uint)get_global_id(1), ix = (uint)get_global_id(2);
    if (ix >= layers || iy >= n_y || iz >= n_z) return;
    const uint cell = cell_index(ix, iy, iz, n_y, n_z_padded);
    const float spacing = frame[3];
    int_lanes x, y, z;
    const intw in_cell = (int)(group * CLR_WIDTH) + TO_INTW(LANE_INDEX);
    x.all = (int)(CLR_NODES * ix) + in_cell / (CLR_NODES * CLR_NODES);
    y.all = (int)(CLR_NODES * iy) + in_cell / CLR_NODES % CLR_NODES;
    z.all = (int)(CLR_NODES * iz) + in_cell % CLR_NODES;
    real_lanes distance;
    distance.all = middle[cell];
    /* Nodes one step outside the cell count too: the surface may run between two cells. */
    const float reach = 0.5f * (CLR_NODES + 1) * ROOT_OF_3 * 1.0001f * spacing;
    if (middle[cell] <= reach && middle[cell] >= -reach) {
        near_cones near;
        near.any_palm = palm_near[cell];
        near.any_digits = digits_near[cell];
        near.palm = (int)near.any_palm;
        near.digits = (int)near.any_digits;
        positions p;
        p.x = frame[0] + (TO_REALW(x.all) + 0.5f) * spacing;
        p.y = frame[1] + (TO_REALW(y.all) + 0.5f) * spacing;
        p.z = frame[2] + (TO_REALW(z.all) + 0.5f) * spacing;
        distance.all = flesh_distance_at(frame, cones, near, p).distance;
    }
    for (int lane = 0; lane < CLR_WIDTH; ++lane)
        nodes[((size_t)x.lane[lane] * (CLR_NODES * n_y) + y.lane[lane]) * (CLR_NODES * n_z) + z.lane[lane]] =
            distance.lane[lane];
}

/* Points, and the field at them. */
#define POINTS_AND_FIELD \
    const uint n_padded, const uint n_x, const uint n_y, const uint n_z, const uint n_z_padded, \
        __global const float *frame, __global const float *cones, __global const uint *palm_near, \
        __global const uint *digits_near, __global const float *points

/* Signed distances of points.
 *
 * points    float (3, n_padded)  metres; n_padded is a multiple of 8
 * distance  float (n_padded)     out: metres, negative inside */
__kernel void flesh_distances(POINTS_AND_FIELD, __global float *distance) {
    const uint at = (uint)get_global_id(0) * CLR_WIDTH;
    if (at >= n_padded) return;
    const positions p = load_points(points, n_padded, at);
    const near_cones near = near_points(frame, n_x, n_y, n_z, n_z_padded, palm_near, digits_near, p);
    STOREW(flesh_distance_at(frame, cones, near, p).distance, distance + at);
}

/* Gradients of the signed distances of points: float (3, n_padded), out. The rest as in flesh_distances. */
__kernel void flesh_gradients(POINTS_AND_FIELD, __global float *gradient) {
    const uint at = (uint)get_global_id(0) * CLR_WIDTH;
    if (at >= n_padded) return;
    const positions p = load_points(points, n_padded, at);
    const near_cones near = near_points(frame, n_x, n_y, n_z, n_z_padded, palm_near, digits_near, p);
    const distance_gradient s = flesh_distance_at(frame, cones, near, p);
    STOREW(s.x, gradient + at);
    STOREW(s.y, gradient + n_padded + at);
    STOREW(s.z, gradient + 2 * (size_t)n_padded + at);
}

/* Nearest part of points: int (n_padded), out, 0 for the palm, then the digits. The rest as in flesh_distances. */
__kernel void flesh_parts(POINTS_AND_FIELD, __global int *part) {
    const uint at = (uint)get_global_id(0) * CLR_WIDTH;
    if (at >= n_padded) return;
    const positions p = load_points(points, n_padded, at);
    const near_cones near = near_points(frame, n_x, n_y, n_z, n_z_padded, palm_near, digits_near, p);
    realw least = united_palm(cones, near, p).distance;
    intw nearest = 0;
    for (int digit = 0; digit < DIGITS; ++digit) {
        const realw distance =
            united_digit(nothing_near(), cones, digit, 0, DIGIT, near, p).distance;
        nearest = distance < least ? (intw)(digit + 1) : nearest;
        least = lesser(distance, least);
    }
    STOREW(AS_REALW(nearest), (__global float *)part + at);
}

/* Quadrature points of a triangle mesh, what of them antennas see, and their roughness (docs/equations.md, E12).
 *
 * A piece is a face or a part of one that was cut across its longest edge. It is cut into k^2 congruent
 * triangles, and each stands for its centroid: the midpoint rule. Nothing here is random but the waves of the roughness,
 * which come from the host. Coordinates are relative to the middle of the scene, so that float32 keeps
 * the phases; rays start from the flat face in the antenna frame, as in visibility.cl.
 *
 * Pieces: start uint (n_pieces + 1), first point of each; face int (n_pieces); corner float (n_pieces, 3, 2), barycentric
 * coordinates b1 and b2 of its corners in its face; edge_points uint (n_pieces), k.
 * Faces: corner float (n_faces, 3, 3) relative to the middle, metres; height and normal as in common/curved.h;
 * face_normal float (n_faces, 3); texture float (n_faces, 3, 3), corners in the coordinates of the roughness, metres. */
#include "common/width.h"
#include "common/curved.h"

#ifndef CLR_GROUP
#error "CLR_GROUP (antennas of a group) is missing"
#endif

/* Where a point is in its face: barycentric coordinates, and the area of its triangle in them. */
typedef struct {
    float b1, b2, share;
    uint piece;
    float edge[4]; /* b1 and b2 along two edges of its triangle or of its reflection in a point */
} place;

static inline place place_of(const uint sample, const uint n_pieces, __global const uint *start,
                             __global const float *corner, __global const uint *edge_points) {
    uint low = 0, high = n_pieces; /* start[low] <= sample < start[high] */
    while (high - low > 1) {
        const uint middle = low + (high - low) / 2;
        if (start[middle] <= sample) low = middle;
        else high = middle;
    }
    const uint j = sample - start[low], k = edge_points[low];
    /* Row i, counted from the first corner, holds 2 i + 1 triangles, in turn with a vertex and an edge ahead. */
    uint i = (uint)sqrt((float)j);
    if (i * i > j) --i;
    if ((i + 1) * (i + 1) <= j) ++i;
    const uint along = j - i * i, column = along >> 1;
    const float third = 1.0f / 3.0f, edge = (float)(along & 1) * third;
    const float x = ((float)i + 2.0f * third - edge) / (float)k;
    const float y = ((float)column + third + edge) / (float)k;
    __global const float *c = corner + 6 * (size_t)low;
    place at;
    at.piece = low;
    at.b1 = c[0] + x * (c[2] - c[0]) + y * (c[4] - c[2]);
    at.b2 = c[1] + x * (c[3] - c[1]) + y * (c[5] - c[3]);
    const float twice = (c[2] - c[0]) * (c[5] - c[1]) - (c[4] - c[0]) * (c[3] - c[1]);
    at.share = 0.5f * absolute(twice) / (float)(k * k);
    for (int j = 0; j < 4; ++j) at.edge[j] = (c[2 + j] - c[j & 1]) / (float)k;
    return at;
}

/* The curved surface at a point, and the place in the coordinates of the roughness. */
typedef struct {
    float3 offset;         /* from the flat face, metres */
    float3 along1, along2; /* derivatives of the position by b1 and b2, metres */
    float3 across;         /* their cross product */
} surface;

static inline surface surface_at(const place at, __global const float *corner,
                                 __global const float *height, __global const float *normal) {
    surface s;
    s.offset = curved_offset(height, normal, at.b1, at.b2);
    curved_tangents(corner, height, normal, at.b1, at.b2, &s.along1, &s.along2);
    s.across = cross3(s.along1, s.along2);
    return s;
}

static inline float3 flat_point(const place at, __global const float *corner) {
    const float3 c = load3(corner);
    return c + at.b1 * (load3(corner + 3) - c) + at.b2 * (load3(corner + 6) - c);
}

/* middle float4         of the scene, metres
 * flat      float (n, 3)  out: on the flat face, in the antenna frame, metres
 * geometric float (n, 3)  out: normal of the face
 * point     float (n, 3)  out: on the smooth surface, relative to the middle
 * unit_normal float (n, 3)  out: of the smooth surface, on the side of the face's normal */
__kernel void quadrature_points(const uint n_pieces, const uint first, const uint n, const float4 middle,
                                __global const uint *start, __global const int *face,
                                __global const float *piece, __global const uint *edge_points,
                                __global const float *corner, __global const float *height,
                                __global const float *normal, __global const float *face_normal,
                                __global float *flat,
                                __global float *geometric, __global float *point,
                                __global float *unit_normal) {
    const uint i = (uint)get_global_id(0);
    if (i >= n) return;
    const place at = place_of(first + i, n_pieces, start, piece, edge_points);
    const size_t f = (size_t)face[at.piece];
    const surface s = surface_at(at, corner + 9 * f, height + 6 * f, normal + 9 * f);
    const float3 g = load3(face_normal + 3 * f), p = flat_point(at, corner + 9 * f);
    const float3 side = dot3(s.across, g) < 0.0f ? -s.across : s.across;
    store3(p + (float3)(middle.x, middle.y, middle.z), flat + 3 * (size_t)i);
    store3(g, geometric + 3 * (size_t)i);
    store3(p + s.offset, point + 3 * (size_t)i);
    store3(unit(side), unit_normal + 3 * (size_t)i);
}

/* Antennas that each side of a point sees: above the face and above the smooth surface, and nothing in between.
 *
 * antenna  float (3, 8 n_groups)   relative to the middle, metres
 * unit_normal, geometric, point as above
 * visible  uchar (n, n_groups)     in: antennas whose rays nothing stops; out: those on the normal's side
 * behind   uchar (n, n_groups)     out: those on the other side
 * count    uint (n, 2)             out: number on the normal's side, and on the other
 * nearest  float (n)               out: squared distance of the nearest antenna, metres^2; combined with what is
 *                                  there unless `only` */
__kernel void sides_seen(const uint n, const uint n_groups, const uint only,
                         __global const float *antenna, __global const float *point,
                         __global const float *unit_normal, __global const float *geometric,
                         __global uchar *visible, __global uchar *behind, __global uint *count,
                         __global float *nearest) {
    const uint i = (uint)get_global_id(0);
    if (i >= n) return;
    const float3 p = load3(point + 3 * (size_t)i), m = load3(unit_normal + 3 * (size_t)i);
    const float3 g = load3(geometric + 3 * (size_t)i);
    const uint n_padded = CLR_GROUP * n_groups;
    realw least = FLT_MAX;
    uint front_count = 0, behind_count = 0;
    for (uint group = 0; group < n_groups; ++group) {
        const uint seen = visible[(size_t)i * n_groups + group];
        uint front = 0, back = 0;
        for (uint lane = 0; lane < CLR_GROUP; lane += CLR_WIDTH) {
            __global const float *a = antenna + CLR_GROUP * group + lane;
            const realw x = LOADW(a) - p.x, y = LOADW(a + n_padded) - p.y, z = LOADW(a + 2 * n_padded) - p.z;
            least = lesser(least, x * x + y * y + z * z);
            if (!seen) continue;
            const realw smooth = x * m.x + y * m.y + z * m.z, plain = x * g.x + y * g.y + z * g.z;
            const intw above = (smooth > 0.0f) & (plain > 0.0f), below = (smooth < 0.0f) & (plain < 0.0f);
            for (uint at = 0; at < CLR_WIDTH; ++at) {
                front |= (uint)(INT_LANE(above, at) != 0) << (lane + at);
                back |= (uint)(INT_LANE(below, at) != 0) << (lane + at);
            }
        }
        front &= seen;
        back &= seen;
        visible[(size_t)i * n_groups + group] = (uchar)front;
        behind[(size_t)i * n_groups + group] = (uchar)back;
        for (; front; front &= front - 1) ++front_count;
        for (; back; back &= back - 1) ++behind_count;
    }
    float closest = LANE(least, 0);
    for (uint at = 1; at < CLR_WIDTH; ++at) closest = smaller(closest, LANE(least, at));
    nearest[i] = only ? closest : smaller(closest, nearest[i]);
    count[2 * (size_t)i] = front_count;
    count[2 * (size_t)i + 1] = behind_count;
}

/* 1 / x and 1 / sqrt(x), or 0 where x is too small for either. */
static inline float inverse_or_0(const float x) {
    return x > 1e-36f ? 1.0f / x : 0.0f;
}

static inline float root_inverse(const float x) {
    return sqrt(inverse_or_0(x));
}

/* What lit points need; n_padded columns, a multiple of CLR_WIDTH; those beyond n are left as they are.
 *
 * sample  uint (n)   ordinal of each point
 * side    float (n)  1: the side of the face's normal, -1 the other
 * out     float (12, n_padded)  position relative to the middle, metres; N dA, metres^2; two edges of the point's triangle
 *         in the plane that touches the smooth surface there, metres
 * frame   float (18, n_padded)  unit normal; place in the coordinates of the roughness, metres; its derivatives by b1
 *         and b2; and the vectors that make of the derivatives of a height by b1 and b2 its gradient, 1/metres */
__kernel void lit_points(const uint n_pieces, const uint n, const uint n_padded, __global const uint *start,
                         __global const int *face, __global const float *piece,
                         __global const uint *edge_points, __global const float *corner,
                         __global const float *height, __global const float *normal,
                         __global const float *face_normal, __global const float *texture,
                         __global const uint *sample, __global const float *side,
                         __global float *out, __global float *frame) {
    const uint i = (uint)get_global_id(0);
    if (i >= n) return;
    const place at = place_of(sample[i], n_pieces, start, piece, edge_points);
    const size_t f = (size_t)face[at.piece];
    __global const float *c = corner + 9 * f, *t = texture + 9 * f;
    const surface s = surface_at(at, c, height + 6 * f, normal + 9 * f);
    const float outward = dot3(s.across, load3(face_normal + 3 * f)) < 0.0f ? -side[i] : side[i];

    /* Coordinates of the roughness follow from the face's, with its edges and its normal turned to theirs. */
    const float3 e1 = load3(c + 3) - load3(c), e2 = load3(c + 6) - load3(c), up = cross3(e1, e2);
    const float3 t1 = load3(t + 3) - load3(t), t2 = load3(t + 6) - load3(t);
    const float3 t_up = cross3(t1, t2) * root_inverse(dot3(cross3(t1, t2), cross3(t1, t2)));
    const float inverse_up = inverse_or_0(dot3(up, up));
    const float3 by1 = cross3(e2, up) * inverse_up, by2 = cross3(up, e1) * inverse_up, n_up = up * root_inverse(dot3(up, up));
#define TURNED(v) (dot3(v, by1) * t1 + dot3(v, by2) * t2 + dot3(v, n_up) * t_up)

    const float square = dot3(s.across, s.across), inverse = inverse_or_0(square);
    const float3 columns[10] = {flat_point(at, c) + s.offset,
                                s.across * (outward * at.share),
                                at.edge[0] * s.along1 + at.edge[1] * s.along2,
                                at.edge[2] * s.along1 + at.edge[3] * s.along2,
                                s.across * (outward * root_inverse(square)),
                                load3(t) + at.b1 * t1 + at.b2 * t2 + TURNED(s.offset),
                                TURNED(s.along1),
                                TURNED(s.along2),
                                cross3(s.along2, s.across) * inverse,
                                cross3(s.across, s.along1) * inverse};
    for (int k = 0; k < 10; ++k) {
        __global float *to = (k < 4 ? out + 3 * k * (size_t)n_padded : frame + 3 * (k - 4) * (size_t)n_padded) + i;
        to[0] = columns[k].x;
        to[n_padded] = columns[k].y;
        to[2 * (size_t)n_padded] = columns[k].z;
    }
}

/* Where the voxels or points of the smallest blocks are (backproject_fast.cl, forward_fast.cl). */
#ifndef CLR_LEAF
#error "CLR_LEAF (most rows or columns of a smallest block, held in private memory) is missing"
#endif
#ifndef CLR_POINTS
#error "CLR_POINTS (1 for points, 0 for the voxels of a grid) is missing"
#endif

#include "common/block_phases.h"

/* CLR_WIDTH voxels relative to the centre of a block, metres; with CLR_FAR the rests of the float32 numbers, too. */
typedef struct {
    realw x, y, z;
#if CLR_FAR
    realw x_rest, y_rest, z_rest;
#endif
} offsets;

/* |v - a| - |c - a| per lane, for v = c + o and an antenna float (6): x, y, z as hi, then as lo. */
static inline length_type length_from_centre(const offsets o, __global const float *c,
                                             __global const float *a) {
#if CLR_FAR
    const realw none = 0.0f;
    const dual cx = from_antenna(c[0], none, a[0], a[3]);
    const dual cy = from_antenna(c[1], none, a[1], a[4]);
    const dual cz = from_antenna(c[2], none, a[2], a[5]);
    const dual ox = {o.x, o.x_rest}, oy = {o.y, o.y_rest}, oz = {o.z, o.z_rest};
    return length_difference(dual_add(cx, ox), dual_add(cy, oy), dual_add(cz, oz), cx, cy, cz);
#else
    const float cx = c[0] - a[0], cy = c[1] - a[1], cz = c[2] - a[2];
    return length_difference(o.x + cx, o.y + cy, o.z + cz, cx, cy, cz, o.x, o.y, o.z,
                             square_root((realw)(cx * cx + cy * cy + cz * cz)));
#endif
}

/* Number of voxels or points of a block. */
static inline uint leaf_size(const uint n_voxels, __global const int *first) {
#if CLR_POINTS
    return (uint)(first[1] - first[0]);
#else
    return n_voxels;
#endif
}

/* CLR_WIDTH voxels of a block, relative to its centre.
 *
 * offset   float (6 or 3, n_offsets)           x, y, z as hi, then with CLR_FAR as lo, metres: of the voxels of
 *                                              any block from its exact centre, or of every point from the float32
 *                                              centre of its block; CLR_WIDTH numbers may be read from any on
 * rest     float (3)                           exact centre minus its float32, metres; 0 for points
 * first    int (3)                             x, y, z index of the block's first voxel; or the block's first
 *                                              point, the one after its last, 0 */
static inline offsets load_offsets(const uint n_offsets, const uint voxel,
                                   __global const float *offset, __global const float *rest,
                                   __global const int *first) {
#if CLR_POINTS
    __global const float *at = offset + first[0] + voxel;
#else
    __global const float *at = offset + voxel;
#endif
    offsets o;
    o.x = LOADW(at) + rest[0];
    o.y = LOADW(at + n_offsets) + rest[1];
    o.z = LOADW(at + 2 * (size_t)n_offsets) + rest[2];
#if CLR_FAR
    o.x_rest = LOADW(at + 3 * (size_t)n_offsets) + ((LOADW(at) - o.x) + rest[0]);
    o.y_rest = LOADW(at + 4 * (size_t)n_offsets) + ((LOADW(at + n_offsets) - o.y) + rest[1]);
    o.z_rest =
        LOADW(at + 5 * (size_t)n_offsets) + ((LOADW(at + 2 * (size_t)n_offsets) - o.z) + rest[2]);
#endif
    return o;
}

/* Index into the volume, or into the points, of a voxel of a block; -1 where there is none.
 *
 * place    int (n_voxels, 3)                   x, y, z index of a voxel in its block; not read for points */
static inline long leaf_index(const uint n_x, const uint n_y, const uint n_z, const uint voxel,
                              __global const int *first, __global const int *place) {
#if CLR_POINTS
    const long point = (long)first[0] + voxel;
    return point < first[1] ? point : -1;
#else
    __global const int *s = place + 3 * voxel;
    const uint x = (uint)(first[0] + s[0]), y = (uint)(first[1] + s[1]);
    const uint z = (uint)(first[2] + s[2]);
    return x < n_x && y < n_y && z < n_z ? ((long)z * n_y + y) * n_x + x : -1;
#endif
}

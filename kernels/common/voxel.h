/* Voxels of one work-item and their distance to an antenna. */
#include "common/phase.h"

typedef struct {
    realw x_hi, x_lo;
    float y_hi, y_lo, z_hi, z_lo;
} voxels;

/* axes: float (n_x_padded + n_y + n_z, 2), metres; plane 0 is hi and plane 1 lo within each axis:
 * x hi (n_x_padded), x lo (n_x_padded), then y hi, lo pairs, then z hi, lo pairs. */
static inline voxels load_voxels(__global const float *axes, uint n_x_padded, uint n_y, uint ix,
                                 uint iy, uint iz) {
    voxels v;
    v.x_hi = LOADW(axes + ix);
    v.x_lo = LOADW(axes + n_x_padded + ix);
    __global const float *y = axes + 2 * n_x_padded + 2 * iy;
    __global const float *z = axes + 2 * n_x_padded + 2 * (n_y + iz);
    v.y_hi = y[0];
    v.y_lo = y[1];
    v.z_hi = z[0];
    v.z_lo = z[1];
    return v;
}

/* From each voxel to an antenna, metres; antenna: float (6): x, y, z as hi, then as lo, metres. */
static inline dual distance_to(const voxels v, __global const float *antenna) {
    return dual_length(dual_difference(v.x_hi, v.x_lo, antenna[0], antenna[3]),
                       dual_difference(v.y_hi, v.y_lo, antenna[1], antenna[4]),
                       dual_difference(v.z_hi, v.z_lo, antenna[2], antenna[5]));
}

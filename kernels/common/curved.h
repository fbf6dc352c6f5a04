/* Points of the smooth surface that a face and the normals at its corners describe (docs/equations.md, E1):
 *
 *     p* = p - 1/2 sum_i b_i ((p - v_i).n_i) n_i,    p = sum_i b_i v_i,
 *
 * half of the way from p to the barycentric mean of its projections on the tangent planes at the corners v_i
 * (T. Boubekeur and M. Alexa, "Phong tessellation", ACM TOG 27(5) (2008) 141, with the shape factor 1/2, which makes it
 * exact for arcs to second order). Signs of normals do not matter.
 *
 * With the heights h_ij = (v_j - v_i).n_i of the corners over the tangent planes, which the host computes in float64,
 * (p - v_i).n_i = H_i = sum_j b_j h_ij. Where all heights are 0 the face is flat, and offset and its derivatives are
 * exactly 0.
 *
 * height  float (n_faces, 3, 2)  h_01, h_02; h_12, h_10; h_20, h_21, metres
 * normal  float (n_faces, 3, 3)  unit normals at the corners
 * corner  float (n_faces, 3, 3)  corners, metres
 * All pointers are those of the face. b1 and b2 are the weights of corners 1 and 2. */
#include "common/vector.h"

/* H_0, H_1, H_2, metres. */
static inline float3 corner_heights(__global const float *height, const float b1, const float b2) {
    const float b0 = 1.0f - b1 - b2;
    return (float3)(b1 * height[0] + b2 * height[1], b2 * height[2] + b0 * height[3],
                    b0 * height[4] + b1 * height[5]);
}

/* p* - p, metres: at most sin(tilt) / 3 of the longest edge, tilt being the largest angle between a normal and that of
 * the face. */
static inline float3 curved_offset(__global const float *height, __global const float *normal,
                                   const float b1, const float b2) {
    const float3 over = corner_heights(height, b1, b2);
    return -0.5f * ((1.0f - b1 - b2) * over.x * load3(normal) + b1 * over.y * load3(normal + 3) +
                    b2 * over.z * load3(normal + 6));
}

/* d p* / d b1 and d p* / d b2, metres. Their cross product is normal to the curved surface and as long as it has area
 * per unit of b1 and b2; for a flat face that is twice the area of the face. */
static inline void curved_tangents(__global const float *corner, __global const float *height,
                                   __global const float *normal, const float b1, const float b2,
                                   float3 *along1, float3 *along2) {
    const float b0 = 1.0f - b1 - b2;
    const float3 n0 = load3(normal), n1 = load3(normal + 3), n2 = load3(normal + 6);
    const float3 over = corner_heights(height, b1, b2);
    /* d H_i / d b1 = h_i1 - h_i0, and the same for b2. */
    const float3 slope1 = (b0 * height[0]) * n0 - (b1 * height[3]) * n1 +
                          (b2 * (height[5] - height[4])) * n2;
    const float3 slope2 = (b0 * height[1]) * n0 + (b1 * (height[2] - height[3])) * n1 -
                          (b2 * height[4]) * n2;
    *along1 = (load3(corner + 3) - load3(corner)) - 0.5f * (over.y * n1 - over.x * n0 + slope1);
    *along2 = (load3(corner + 6) - load3(corner)) - 0.5f * (over.z * n2 - over.x * n0 + slope2);
}

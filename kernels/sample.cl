/* Stratified samples of a triangle mesh (docs/equations.md, E1).
 *
 * Face f holds samples face_start[f] ... face_start[f + 1] - 1. Its j-th of k points is the point of a
 * stratified set, a jittered Fibonacci lattice: first coordinate (j + xi) / k with xi random per sample,
 * second coordinate j times the golden ratio, modulo 1, with a random rotation per face (Cranley and
 * Patterson 1976), mapped to the triangle by the square root (R. Osada et al., ACM TOG 21 (2002) 807,
 * eq. 1). Each point by itself is uniform on its face.
 *
 * Random numbers: Philox4x32-10 (J. Salmon et al., SC 2011), key = seed, counter =
 * (sample or face, 0, 0, domain).
 *
 * Every sample has two positions: on the flat face, where rays start, since the tree holds flat faces, and on the
 * curved surface that the normals describe (common/curved.h), to which paths are measured. */
#include "common/width.h"
#include "common/random.h"
#include "common/curved.h"

/* face_start  uint (n_faces + 1)    first sample of each face
 * corner      float (n_faces, 3, 3) corners, metres
 * normal      float (n_faces, 3, 3) unit normals at the corners
 * height      float (n_faces, 3, 2) see common/curved.h
 * face_normal float (n_faces, 3)    unit normal of the face
 * ground      float (n_samples, 3)  out: positions on the flat faces, metres
 * shading     float (n_samples, 3)  out: interpolated unit normals
 * geometric   float (n_samples, 3)  out: face normals
 * face        int (n_samples)       out
 * point       float (n_samples, 3)  out: positions on the curved surface, metres */
__kernel void sample_surface(const uint n_faces, const uint first_sample, const uint n_samples,
                             const uint seed_low, const uint seed_high,
                             __global const uint *face_start, __global const float *corner,
                             __global const float *normal, __global const float *height,
                             __global const float *face_normal, __global float *ground,
                             __global float *shading, __global float *geometric,
                             __global int *face, __global float *point) {
    const uint i = (uint)get_global_id(0);
    if (i >= n_samples) return;
    const uint sample = first_sample + i;

    uint low = 0, high = n_faces; /* face_start[low] <= sample < face_start[high] */
    while (high - low > 1) {
        const uint middle = low + (high - low) / 2;
        if (face_start[middle] <= sample) low = middle;
        else high = middle;
    }
    const uint j = sample - face_start[low];
    const uint k = face_start[low + 1] - face_start[low];

    const uint4 jitter = draw(sample, 0, 0, DOMAIN_SAMPLE, seed_low, seed_high);
    const uint4 rotation = draw(low, 0, 0, DOMAIN_FACE, seed_low, seed_high);
    const float a = ((float)j + unit_interval(jitter.x)) / (float)k;
    const float b = unit_interval(j * GOLDEN_RATIO + rotation.x);

    const float root = sqrt(smaller(a, 1.0f));
    const float b1 = root * (1.0f - b), b2 = root * b, b0 = 1.0f - root;
    const size_t f = (size_t)low, at = 9 * f;
    float flat[3], blend[3];
    for (int axis = 0; axis < 3; ++axis) {
        __global const float *c = corner + at + axis, *n = normal + at + axis;
        flat[axis] = b0 * c[0] + b1 * c[3] + b2 * c[6];
        blend[axis] = b0 * n[0] + b1 * n[3] + b2 * n[6];
        geometric[3 * (size_t)i + axis] = face_normal[3 * f + axis];
    }
    const float3 p = (float3)(flat[0], flat[1], flat[2]);
    store3(p, ground + 3 * (size_t)i);
    store3(p + curved_offset(height + 6 * f, normal + at, b1, b2), point + 3 * (size_t)i);
    const float3 n = (float3)(blend[0], blend[1], blend[2]);
    const float norm = length3(n);
    store3(norm > 1e-6f ? n / norm : load3(face_normal + 3 * f), shading + 3 * (size_t)i);
    face[i] = (int)low;
}

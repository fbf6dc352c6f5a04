/* The strongest voxel along z, from which a depth map is made (E9 in docs/equations.md). */
#include "common/width.h"

/* sqrt(re^2 + im^2) without overflow. */
static inline realw amplitude(realw re, realw im) {
    const realw a = AS_REALW(AS_INTW(re) & 0x7fffffff), b = AS_REALW(AS_INTW(im) & 0x7fffffff);
    const realw larger = greater(a, b), ratio = lesser(a, b) / larger;
    return choose(larger > 0.0f, larger * sqrt(1.0f + ratio * ratio), larger);
}

/* Item = CLR_WIDTH pixels.
 *
 * n_pixels, n_written                          pixels, and with padding to CLR_WIDTH
 * divisor                                      by which the volume's values are divided
 * volume  float (2, n_z, n_pixels)             real, imaginary part; CLR_WIDTH numbers may be read beyond
 * top     int (n_written)                      out: z of the first of the strongest; -1 where one is not
 *                                              finite
 * values  float (3, n_written, 2)              out: the complex value before it (or its own at the end of the
 *                                              grid), its own, that after it */
__kernel void strongest_along_z(const uint n_pixels, const uint n_written, const uint n_z,
                                const float divisor, __global const float *volume,
                                __global int *top, __global float *values) {
    const uint pixel = (uint)get_global_id(0) * CLR_WIDTH;
    if (pixel >= n_pixels) return;
    const size_t plane = (size_t)n_z * n_pixels;
    realw strongest = -1.0f;
    intw at = 0;
    intw wrong = 0;
    for (uint z = 0; z < n_z; ++z) {
        __global const float *in = volume + (size_t)z * n_pixels + pixel;
        const realw found = amplitude(LOADW(in) / divisor, LOADW(in + plane) / divisor);
        const intw here = (int)z;
        const intw more = found > strongest;
        strongest = choose(more, found, strongest);
        at = more ? here : at;
        wrong |= !(found <= 3.402823466e38f);
    }
    for (uint lane = 0; lane < CLR_WIDTH && pixel + lane < n_pixels; ++lane) {
        const int z = INT_LANE(at, lane);
        const int near[3] = {z > 0 ? z - 1 : 0, z, z + 1 < (int)n_z ? z + 1 : z};
        top[pixel + lane] = INT_LANE(wrong, lane) ? -1 : z;
        for (uint i = 0; i < 3; ++i) {
            __global const float *in = volume + (size_t)near[i] * n_pixels + pixel + lane;
            __global float *out = values + 2 * ((size_t)i * n_written + pixel + lane);
            out[0] = in[0] / divisor;
            out[1] = in[plane] / divisor;
        }
    }
}

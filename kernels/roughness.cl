/* Displacement of points by a Gaussian height field with correlation exp(-r^2 / l^2), a sum of plane waves
 *     eta(q) = a sum_m cos(2 pi (kappa_m . q + phi_m)),
 * of the coordinates q that are fixed to the body (docs/equations.md, E12). The point moves by eta n, and N dA becomes
 * N dA - |N dA| grad eta, with the gradient along the undisplaced surface.
 *
 * kappa . q is a float32 number of cycles c with an error of some 2^-24 c, and is reduced to one before the sine: for a
 * body of 0.2 m and l = 1 mm (c below 100) 4e-5 radians. Sums of 512 terms lose less.
 *
 * Item = CLR_WIDTH points.
 *
 * material  int (n_padded)           of each point; others than `which` stay as they are
 * wave      float (n_waves, 4)       kappa, cycles per metre, and phi, cycles
 * out, frame as of lit_points in quadrature.cl; position and N dA are changed */
#include "common/phase.h"
#include "common/random.h"

/* Random bits of the waves of a material: two draws of a wave, each of four words.
 *
 * bits  uint (n_waves, 8)  out */
__kernel void wave_bits(const uint n_waves, const uint material, const uint seed_low, const uint seed_high,
                        __global uint *bits) {
    const uint m = (uint)get_global_id(0);
    if (m >= n_waves) return;
    for (uint k = 0; k < 2; ++k) {
        const uint4 r = draw(m, k, material, DOMAIN_WAVE, seed_low, seed_high);
        __global uint *to = bits + 8 * m + 4 * k;
        to[0] = r.x;
        to[1] = r.y;
        to[2] = r.z;
        to[3] = r.w;
    }
}

__kernel void roughen(const uint n_padded, const uint n_waves, const int which, const float amplitude,
                      __global const int *material, __global const float *wave, __global float *out,
                      __global const float *frame) {
    const uint i = (uint)get_global_id(0) * CLR_WIDTH;
    if (i >= n_padded) return;
    float is_mine[CLR_WIDTH];
    int any = 0;
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
        const int same = material[i + lane] == which;
        is_mine[lane] = same ? amplitude : 0.0f;
        any |= same;
    }
    if (!any) return;
#define ROW(k) LOADW(frame + (size_t)(k) * n_padded + i)
    const realw x = ROW(3), y = ROW(4), z = ROW(5), magic = 12582912.0f;
    realw height = 0.0f, by_x = 0.0f, by_y = 0.0f, by_z = 0.0f;
    for (uint m = 0; m < n_waves; ++m) {
        __global const float *w = wave + 4 * m;
        const realw c = fused(x, (realw)(w[0]), fused(y, (realw)(w[1]), z * w[2]));
        realw cosine, sine;
        cos_sin_cycles((c - ((c + magic) - magic)) + w[3], &cosine, &sine);
        height += cosine;
        by_x = fused(sine, (realw)(w[0]), by_x);
        by_y = fused(sine, (realw)(w[1]), by_y);
        by_z = fused(sine, (realw)(w[2]), by_z);
    }
    realw scale;
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) ((float *)&scale)[lane] = is_mine[lane];
    const realw slope = -6.283185307179586f * scale;
    const realw along1 = (by_x * ROW(6) + by_y * ROW(7) + by_z * ROW(8)) * slope;
    const realw along2 = (by_x * ROW(9) + by_y * ROW(10) + by_z * ROW(11)) * slope;
    height *= scale;
    realw area_square = 0.0f;
    for (uint k = 0; k < 3; ++k) {
        const realw a = LOADW(out + (size_t)(3 + k) * n_padded + i);
        area_square += a * a;
    }
    const realw area = sqrt(area_square);
    for (uint k = 0; k < 3; ++k) {
        __global float *p = out + (size_t)k * n_padded + i, *a = p + 3 * (size_t)n_padded;
        STOREW(LOADW(p) + height * ROW(k), p);
        STOREW(LOADW(a) - area * (along1 * ROW(12 + k) + along2 * ROW(15 + k)), a);
    }
}

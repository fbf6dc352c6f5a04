/* The samples of a capture as the tree of blocks reads them (backproject_fast.cl): frequency by frequency,
 * weighted, real and imaginary parts side by side. */
#include "common/dual.h"

/* a w for w = hi + lo, rounded once. The halves of large numbers would overflow. */
static inline realw weighted(realw a, realw hi, realw lo) {
    const realw p = a * hi;
    realw a_high, a_low, high, low;
    halves(a, &a_high, &a_low);
    halves(hi, &high, &low);
    const realw exact = p + (product_error(a_high, a_low, high, low, p) + a * lo);
    return choose((a < 1e30f) & (a > -1e30f), exact, p);
}

/* Item = CLR_WIDTH receivers of one transmitter.
 *
 * n_tx, n_rx, n_columns                        of this cube; receivers with and without padding
 * first_tx, first_rx, n_all_rx, n_stride       where it begins in all samples; numbers from pair to pair
 * samples  float (n_all_tx, n_all_rx, n_stride, 2)  complex numbers by frequency
 * weights  float (2, n_m)                      as hi, then lo
 * cube     float (n_m, n_tx, 2, n_columns)     out; padded with zeros */
__kernel void transpose_samples(const uint n_m, const uint n_tx, const uint n_rx,
                                const uint n_columns, const uint first_tx, const uint first_rx,
                                const uint n_all_rx, const uint n_stride,
                                __global const float *samples, __global const float *weights,
                                __global float *cube) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, tx = (uint)get_global_id(1);
    if (column >= n_columns || tx >= n_tx) return;
    const uint n_here = column < n_rx ? n_rx - column : 0;
    __global const float *in =
        samples + 2 * (((size_t)first_tx + tx) * n_all_rx + first_rx + column) * n_stride;
    __global float *out = cube + (size_t)2 * tx * n_columns + column;
    for (uint m = 0; m < n_m; ++m) {
        float re[CLR_WIDTH], im[CLR_WIDTH];
        for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
            const size_t at = 2 * ((size_t)lane * n_stride + m);
            re[lane] = lane < n_here ? in[at] : 0.0f;
            im[lane] = lane < n_here ? in[at + 1] : 0.0f;
        }
        const realw hi = weights[m], lo = weights[n_m + m];
#if CLR_WIDTH == 8
        const realw a = ((const loose8 *)re)->v, b = ((const loose8 *)im)->v;
#else
        const realw a = re[0], b = im[0];
#endif
        STOREW(weighted(a, hi, lo), out);
        STOREW(weighted(b, hi, lo), out + n_columns);
        out += (size_t)2 * n_tx * n_columns;
    }
}

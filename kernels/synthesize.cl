/* The SFCW phasor sum: s[pair, n] = sum_i a_i exp(-j 2 pi f_n d_i / c).
 *
 * Item = one pair and CLR_WIDTH frequencies. It adds its pair's paths in their order to a sum of two
 * float32 (T. J. Dekker, Numer. Math. 18 (1971) 224), whose state is kept between calls: the result is
 * the same to the bit however the paths are split into calls, and a million equal paths do not drift. */
#include "common/phase.h"

/* start   uint (n_pairs + 1)         first path of each pair in this call
 * path    float (n_paths, 4)         length hi, length lo, amplitude, unused; metres
 * k_hi, k_lo  float (n_freq_padded)  f / c, cycles per metre, as hi + lo
 * state   float (4, n_pairs, n_freq_padded)  in and out: re, im, and the low parts of both */
__kernel void sum_phasors(const uint n_pairs, const uint n_freq_padded,
                          __global const uint *start, __global const float *path,
                          __global const float *k_hi, __global const float *k_lo,
                          __global float *state) {
    const uint block = (uint)get_global_id(0), pair = (uint)get_global_id(1);
    if (pair >= n_pairs || block * CLR_WIDTH >= n_freq_padded) return;
    const uint first = start[pair], last = start[pair + 1];
    if (first == last) return;
    const size_t plane = (size_t)n_pairs * n_freq_padded;
    __global float *at = state + (size_t)pair * n_freq_padded + block * CLR_WIDTH;
    realw re = LOADW(at), im = LOADW(at + plane);
    realw re_lost = LOADW(at + 2 * plane), im_lost = LOADW(at + 3 * plane);
    const wavenumber k =
        make_wavenumber(LOADW(k_hi + block * CLR_WIDTH), LOADW(k_lo + block * CLR_WIDTH));
    for (uint i = first; i < last; ++i) {
        const float4 row = LOAD4(path + 4 * (size_t)i);
        dual length;
        length.hi = row.x;
        length.lo = row.y;
        realw cosine, sine;
        cos_sin_cycles(cycles(length, k), &cosine, &sine);
        const dual a = two_sum(re, cosine * row.z);
        const dual b = two_sum(im, -(sine * row.z));
        /* Renormalised at once: a million equal paths lose the same share each time, and what is lost
         * would by itself outgrow float32. */
        const dual a_whole = two_sum(a.hi, a.lo + re_lost);
        const dual b_whole = two_sum(b.hi, b.lo + im_lost);
        re = a_whole.hi;
        im = b_whole.hi;
        re_lost = a_whole.lo;
        im_lost = b_whole.lo;
    }
    STOREW(re, at);
    STOREW(im, at + plane);
    STOREW(re_lost, at + 2 * plane);
    STOREW(im_lost, at + 3 * plane);
}

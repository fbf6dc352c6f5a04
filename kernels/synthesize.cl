/* The SFCW phasor sum: s[pair, n] = sum_i a_i exp(-j 2 pi f_n d_i / c).
 *
 * Every pair keeps moments of its paths in blocks of path length (docs/equations.md, E7). With k the
 * wavenumber of the band's centre in cycles per metre, kappa_n = f_n / c - k, and x = (d - b W) / (W / 2)
 * the position of a path in block b of length W,
 *     M_bp = sum_i a_i exp(-j 2 pi k d_i) (-j)^(p mod 2) x_i^p,         p = 0 ... 7,
 *     s_n  = sum_b exp(-j 2 pi kappa_n b W) sum_p c_np M_bp.
 * So a path costs one sine and cosine, whatever the number of frequencies and their steps.
 *
 * Block b is kept in slot b mod n_slots of its pair. A block that is evicted from its slot is added to
 * the pair's frequencies: any lengths take the same memory. One item does all that happens to
 * its pair, in the order of the pair's paths, and the state is kept between calls: the result is the same
 * to the bit however the paths are split into calls. Moments and sums are hi + lo, so a million equal paths do
 * not drift. */
#if !defined(CLR_IN_PARTS) || !defined(CLR_PAIRS)
#error "CLR_IN_PARTS (1 where lengths come as hi + lo), CLR_PAIRS (of an item of finish) are missing"
#endif
#if !defined(CLR_MOMENTS) || !defined(CLR_MOST_SLOTS)
#error "CLR_MOMENTS (of a block), CLR_MOST_SLOTS (blocks that a pair keeps) are missing"
#endif
#if CLR_MOMENTS != 8
#error "the moments of a block are held in float8"
#endif

#include "common/phase.h"

#define BLOCK_FLOATS (4 * CLR_MOMENTS)

/* a + b for a running sum of any length, to 2^-46: algorithm 4 of M. Joldes, J.-M. Muller, V. Popescu, ACM
 * Trans. Math. Softw. 44 (2017) 15. Renormalised at once: a million equal paths lose the same share each
 * time, and what is lost would by itself outgrow float32. */
#define ADD_TO(hi, lo, b, type) \
    do { \
        const type s_ = (hi) + (b), t_ = s_ - (hi); \
        const type low_ = (lo) + (((hi) - (s_ - t_)) + ((b) - t_)); \
        (hi) = s_ + low_; \
        (lo) = low_ - ((hi) - s_); \
    } while (0)

/* Coefficients and wavenumbers of CLR_WIDTH frequencies. */
typedef struct {
    realw c[CLR_MOMENTS];
    wavenumber kappa;
} band;

static inline band load_band(__global const float *table, const uint n_freq, const uint n) {
    band r;
    for (int p = 0; p < CLR_MOMENTS; ++p) r.c[p] = LOADW(table + (size_t)p * n_freq + n);
    r.kappa = make_wavenumber(LOADW(table + (size_t)CLR_MOMENTS * n_freq + n),
                              LOADW(table + (size_t)(CLR_MOMENTS + 1) * n_freq + n));
    return r;
}

/* cos and sin of 2 pi kappa b W. */
static inline void block_phase(const int block, const float block_m, const wavenumber kappa,
                               realw *cosine, realw *sine) {
    const dual centre = exact_product((realw)((float)block), (realw)(block_m));
    cos_sin_cycles(cycles(centre, kappa), cosine, sine);
}

/* exp(-j 2 pi kappa_n b W) sum_p c_np M_bp, from the moments m of a block. */
static inline void block_phasor(__global const float *m, const band *f, const realw cosine,
                                const realw sine, realw *re, realw *im) {
    realw x = f->c[0] * m[0], y = f->c[0] * m[CLR_MOMENTS];
    for (int p = 1; p < CLR_MOMENTS; ++p) {
        x = fused(f->c[p], (realw)(m[p]), x);
        y = fused(f->c[p], (realw)(m[CLR_MOMENTS + p]), y);
    }
    *re = fused(x, cosine, y * sine);
    *im = fused(y, cosine, -(x * sine));
}

/* Evict a block: add it to the frequencies of its pair; `fresh`: these are undefined yet. */
static void add_to_sum(const int block, const float block_m, __global const float *m,
                       __global const float *table, const uint n_freq, const bool fresh,
                       __global float *sum) {
    for (uint n = 0; n < n_freq; n += CLR_WIDTH) {
        const band f = load_band(table, n_freq, n);
        realw cosine, sine, x, y;
        block_phase(block, block_m, f.kappa, &cosine, &sine);
        block_phasor(m, &f, cosine, sine, &x, &y);
        __global float *at = sum + n;
        const size_t plane = n_freq;
        realw re = (realw)(0.0f), im = re, re_lost = re, im_lost = re;
        if (!fresh) {
            re = LOADW(at);
            im = LOADW(at + plane);
            re_lost = LOADW(at + 2 * plane);
            im_lost = LOADW(at + 3 * plane);
        }
        ADD_TO(re, re_lost, x, realw);
        ADD_TO(im, im_lost, y, realw);
        STOREW(re, at);
        STOREW(im, at + plane);
        STOREW(re_lost, at + 2 * plane);
        STOREW(im_lost, at + 3 * plane);
    }
}

/* Split float64 lengths, given as their upper and lower 32 bits, into hi + lo to 2^-48 of their size. A
 * device need not have float64. hi gets the first 24 bits of the 53, lo the other 29; below 2^-74 both are 0. */
static inline dual split(const intw upper, const intw lower) {
    const intw least = 949 << 20;
    const intw hi = ((upper - (896 << 20)) << 3) | ((lower >> 29) & 7);
    const intw scale = ((upper >> 20) - 948) << 23; /* of the last of the 53 bits */
    /* Whole numbers below 2^23 as float, by the bits of 2^23 + them. */
    const realw high = AS_REALW(((lower >> 14) & 0x7fff) | 0x4b000000) - 8388608.0f;
    const realw low = AS_REALW((lower & 0x3fff) | 0x4b000000) - 8388608.0f;
    dual r;
    r.hi = AS_REALW(upper >= least ? hi : (intw)(0));
    r.lo = AS_REALW(upper >= least ? scale : (intw)(0)) * (high * 16384.0f + low);
    return r;
}

/* Lengths: float64 from the host, or hi + lo from another kernel, in as many bytes. */
static inline dual length_of(const intw upper, const intw lower) {
#if CLR_IN_PARTS
    dual r;
    r.hi = AS_REALW(lower);
    r.lo = AS_REALW(upper);
    return r;
#else
    return split(upper, lower);
#endif
}

/* CLR_WIDTH of them. */
static inline dual load_lengths(__global const int2 *p) {
#if CLR_WIDTH == 8
    const int8 a = LOAD8I(p), b = LOAD8I(p + 4);
    return length_of((int8)(a.s1, a.s3, a.s5, a.s7, b.s1, b.s3, b.s5, b.s7),
                     (int8)(a.s0, a.s2, a.s4, a.s6, b.s0, b.s2, b.s4, b.s6));
#else
    return length_of(p->y, p->x);
#endif
}

/* Shared by the kernels:
 * n_freq   frequencies, padded to a multiple of CLR_WIDTH
 * n_slots  blocks that a pair keeps, a power of two
 * block_m  length W of a block; its number is at most 2^22
 * table    float (10, n_freq)            c_np; then kappa_n as hi, lo, cycles per metre
 * tag      int (n_slots + 1, n_pairs)    number of the block in the slot, plus 1, or 0 for none; in the last row
 *                                        1 for pairs whose `sum` is defined
 * moments  float (n_slots, n_pairs, 4, 8)  re, im, and lo of both; undefined where tag is 0
 * sum      float (n_pairs, 4, n_freq)    re, im, lo of both; defined where tag's last row is 1
 *
 * Item = one pair: first_pair + its index in this call, below n_items.
 * start      uint (items + 1)            first path of each pair in this call
 * length     int2 (n_paths)              float64 metres as lower and upper 32 bits, or, where CLR_IN_PARTS is 1,
 *                                        float2: metres as hi + lo
 * amplitude  float (n_paths)
 * per_half_block  2 / W
 * k_hi, k_lo  k as hi + lo */
__kernel void add_paths(const uint n_items, const uint n_pairs, const uint first_pair,
                        const uint n_paths, const uint n_freq, const uint n_slots,
                        const float block_m, const float per_half_block, const float k_hi,
                        const float k_lo,
                        __global const uint *start, __global const int2 *length,
                        __global const float *amplitude, __global const float *table,
                        __global int *tag, __global float *moments, __global float *sum) {
    const uint item = (uint)get_global_id(0), pair = first_pair + item;
    if (item >= n_items) return;
    const uint first = start[item], last = start[item + 1];
    const realw magic = 12582912.0f; /* adding it rounds to a whole number */
    const wavenumber k = make_wavenumber((realw)(k_hi), (realw)(k_lo));
    for (uint i = first; i < last;) {
        /* CLR_WIDTH paths from `base` on, of which this pair's are added, from path i on. */
        const uint base = i < n_paths - CLR_WIDTH ? i : n_paths - CLR_WIDTH;
        const uint end = last - base < CLR_WIDTH ? last - base : CLR_WIDTH;
        const dual d = load_lengths(length + base);
        const realw a = LOADW(amplitude + base);
        const realw near = (d.hi * (0.5f * per_half_block) + magic) - magic;
        const dual centre = exact_product(near, (realw)(block_m));
        realw x = (((d.hi - centre.hi) - centre.lo) + d.lo) * per_half_block;
        /* The quotient was rounded: for a long path x may be a little outside. */
        const realw shift = (0.5f * x + magic) - magic, number = near + shift;
        x -= 2.0f * shift;
        realw cosine, sine;
        cos_sin_cycles(cycles(d, k), &cosine, &sine);
        const realw re = cosine * a, im = -(sine * a), x2 = x * x, x4 = x2 * x2;
        for (uint j = i - base; j < end; ++j) {
            const int block = (int)LANE(number, j);
            const size_t at = (size_t)(block & (int)(n_slots - 1)) * n_pairs + pair;
            __global float *m = moments + at * BLOCK_FLOATS;
            float8 hi, lo, minus_j_hi, minus_j_lo;
            if (tag[at] == block + 1) {
                hi = LOAD8(m);
                minus_j_hi = LOAD8(m + 8);
                lo = LOAD8(m + 16);
                minus_j_lo = LOAD8(m + 24);
            } else {
                if (tag[at] != 0) {
                    __global int *in_use = tag + (size_t)n_slots * n_pairs + pair;
                    add_to_sum(tag[at] - 1, block_m, m, table, n_freq, *in_use == 0,
                               sum + (size_t)pair * 4 * n_freq);
                    *in_use = 1;
                }
                tag[at] = block + 1;
                hi = lo = minus_j_hi = minus_j_lo = (float8)(0.0f);
            }
            const float x1 = LANE(x, j), xx = LANE(x2, j), xxxx = LANE(x4, j);
            const float8 power = (float8)(1.0f, x1, 1.0f, x1, 1.0f, x1, 1.0f, x1) *
                                 (float8)(1.0f, 1.0f, xx, xx, 1.0f, 1.0f, xx, xx) *
                                 (float8)(1.0f, 1.0f, 1.0f, 1.0f, xxxx, xxxx, xxxx, xxxx);
            const float zr = LANE(re, j), zi = LANE(im, j);
            const float8 u = power * (float8)(zr, zi, zr, zi, zr, zi, zr, zi);
            const float8 v = power * (float8)(zi, -zr, zi, -zr, zi, -zr, zi, -zr);
            ADD_TO(hi, lo, u, float8);
            ADD_TO(minus_j_hi, minus_j_lo, v, float8);
            STORE8(hi, m);
            STORE8(minus_j_hi, m + 8);
            STORE8(lo, m + 16);
            STORE8(minus_j_lo, m + 24);
        }
        i = base + end;
    }
}

/* What was evicted of a pair, for CLR_WIDTH frequencies. */
typedef struct {
    realw re, im, re_lost, im_lost;
} pair_sum;

static inline pair_sum evicted_of(const uint pair, const uint n, const uint n_pairs, const uint n_freq,
                                  const uint n_slots, __global const int *tag,
                                  __global const float *sum) {
    pair_sum s;
    s.re = s.im = s.re_lost = s.im_lost = (realw)(0.0f);
    if (tag[(size_t)n_slots * n_pairs + pair] != 0) {
        const size_t plane = n_freq;
        __global const float *at = sum + (size_t)pair * 4 * plane + n;
        s.re = LOADW(at);
        s.im = LOADW(at + plane);
        s.re_lost = LOADW(at + 2 * plane);
        s.im_lost = LOADW(at + 3 * plane);
    }
    return s;
}

/* Add a block. So few that the rounding errors may add up in float32. */
static inline void add_block(pair_sum *s, const realw x, const realw y) {
    const dual a = two_sum(s->re, x), b = two_sum(s->im, y);
    s->re = a.hi;
    s->im = b.hi;
    s->re_lost += a.lo;
    s->im_lost += b.lo;
}

static inline void store_sum(const pair_sum s, __global float *out) {
    const realw re = s.re + s.re_lost, im = s.im + s.im_lost;
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
        out[2 * lane] = LANE(re, lane);
        out[2 * lane + 1] = LANE(im, lane);
    }
}

/* The sum of a pair's blocks and evicted blocks; the state stays as it is. Item = `columns` frequencies of CLR_PAIRS
 * pairs, which share the phases of their blocks.
 * out      float (n_pairs, n_freq, 2)    re, im */
__kernel void finish(const uint n_pairs, const uint n_freq, const uint columns, const uint n_slots,
                     const float block_m, __global const float *table, __global const int *tag,
                     __global const float *moments, __global const float *sum,
                     __global float *out) {
    const uint begin = columns * (uint)get_global_id(0), first = CLR_PAIRS * (uint)get_global_id(1);
    if (first >= n_pairs) return;
#if CLR_PAIRS == 1
    for (uint n = begin; n < begin + columns && n < n_freq; n += CLR_WIDTH) {
        const band f = load_band(table, n_freq, n);
        pair_sum s = evicted_of(first, n, n_pairs, n_freq, n_slots, tag, sum);
        for (uint slot = 0; slot < n_slots; ++slot) {
            const size_t at = (size_t)slot * n_pairs + first;
            if (tag[at] == 0) continue;
            realw cosine, sine, x, y;
            block_phase(tag[at] - 1, block_m, f.kappa, &cosine, &sine);
            block_phasor(moments + at * BLOCK_FLOATS, &f, cosine, sine, &x, &y);
            add_block(&s, x, y);
        }
        store_sum(s, out + 2 * ((size_t)first * n_freq + n));
    }
#else
    const uint n_here = n_pairs - first < CLR_PAIRS ? n_pairs - first : CLR_PAIRS;
    uchar used[CLR_PAIRS * CLR_MOST_SLOTS];
    uint n_used[CLR_PAIRS];
    for (uint i = 0; i < n_here; ++i) {
        n_used[i] = 0;
        for (uint slot = 0; slot < n_slots; ++slot) {
            used[i * CLR_MOST_SLOTS + n_used[i]] = (uchar)slot;
            n_used[i] += tag[(size_t)slot * n_pairs + first + i] != 0;
        }
    }
    for (uint n = begin; n < begin + columns && n < n_freq; n += CLR_WIDTH) {
        const band f = load_band(table, n_freq, n);
        /* Neighbouring pairs mostly have the same blocks in their slots. */
        int block[CLR_MOST_SLOTS];
        realw cosine[CLR_MOST_SLOTS], sine[CLR_MOST_SLOTS];
        for (uint slot = 0; slot < n_slots; ++slot) block[slot] = -1;
        for (uint i = 0; i < n_here; ++i) {
            const uint pair = first + i;
            pair_sum s = evicted_of(pair, n, n_pairs, n_freq, n_slots, tag, sum);
            for (uint k = 0; k < n_used[i]; ++k) {
                const uint slot = used[i * CLR_MOST_SLOTS + k];
                const size_t at = (size_t)slot * n_pairs + pair;
                if (tag[at] - 1 != block[slot]) {
                    block[slot] = tag[at] - 1;
                    block_phase(block[slot], block_m, f.kappa, &cosine[slot], &sine[slot]);
                }
                realw x, y;
                block_phasor(moments + at * BLOCK_FLOATS, &f, cosine[slot], sine[slot], &x, &y);
                add_block(&s, x, y);
            }
            store_sum(s, out + 2 * ((size_t)pair * n_freq + n));
        }
    }
#endif
}

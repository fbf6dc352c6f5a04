/* The Kirchhoff sum over lit points (docs/equations.md, E12),
 *     s = c0 sum_p (along_t + along_r) leg_t leg_r exp(-j k (R_t + R_r)),   along = s.N dA,   leg = V g(theta) G / R,
 * coherent legs times exp(-k^2 (slope.s - level)), the mean of the phase over the point's triangle (clradar.phasors.leg_skeletons),
 * compressed over cubes of space. Relative to the middle of its cube the phase of a point varies slowly over antennas and
 * frequencies, so the sum of a cube is needed at a few frequencies only and, of points that all antennas
 * see, for a few antennas; fixed real weights give the rest (clradar.phasors.leg_skeletons).
 *
 * Terms: (along_t leg_t) leg_r + leg_t (along_r leg_r), and with CLR_TERMS 3 the incoherent part of micro-roughness. A leg has
 * two numbers (real, imaginary) for each of them.
 *
 * Antennas are kept in blocks of 8: of the numbers of a leg, float (n_m, n_blocks, n_points, 2 CLR_TERMS, 8). No result
 * depends on how points are split into calls: sums go on where they were left. */
#include "common/phase.h"
#include "common/random.h"
#include "common/vector.h"

#if !defined(CLR_TERMS) || !defined(CLR_MATERIALS) || !defined(CLR_PATTERN) || !defined(CLR_NODES) || \
    !defined(CLR_PATTERN_NODES) || !defined(CLR_POINT)
#error "CLR_TERMS (2 or 3), CLR_MATERIALS (1: table), CLR_PATTERN (1: table), CLR_NODES, CLR_PATTERN_NODES (of them), CLR_POINT (numbers of a point) are missing"
#endif

#define BLOCK 8       /* antennas */
#define PARTS (2 * CLR_TERMS)
#define ROWS 4        /* rows of a tile of products */
#define FREQUENCIES 4 /* that an item of add_cubes sums */

/* Numbers of a point. */
#define OFFSET 0   /* from the middle of its cube, metres */
#define VECTOR 3   /* N dA, square metres */
#define MATERIAL 6 /* int */
#define SAMPLE 7   /* uint, its ordinal */
#define SLOPE 8    /* for its triangle, square metres */
#define LEVEL 11   /* square metres */

/* Table values by linear interpolation, one lane after the other. x: 0 to 1 */
static inline realw looked_up(__global const float *table, const uint stride, const uint n_nodes, const realw x) {
    realw value;
    for (uint lane = 0; lane < CLR_WIDTH; ++lane) {
        const float at = smaller(LANE(x, lane), 1.0f) * (float)(n_nodes - 1);
        const uint low = (uint)smaller(at, (float)(n_nodes - 2));
        const float rest = at - (float)low;
        const float a = table[stride * low], b = table[stride * (low + 1)];
        ((float *)&value)[lane] = a + rest * (b - a);
    }
    return value;
}

/* Legs from some points to the antennas of one side. Item = CLR_WIDTH antennas of one point.
 *
 * antenna  float (9, n_padded)        x, y, z as hi, then as lo, relative to the middle of the scene, metres, and the unit
 *                                     vector of the boresight; n_padded a multiple of 8
 * point    float (n, CLR_POINT)       see above
 * cube     int (n)                    of each point
 * centre   float (n_cubes, 3)         of cubes, relative to the middle of the scene, metres
 * visible  uchar (n, n_groups)        antennas that see each point; not read where n_groups is 0: all do
 * k        float (n_m)                cycles per metre
 * material float (n_materials, n_m, CLR_NODES, 3)  real and imaginary part of g, and amplitude of the
 *                                     incoherent part, over sqrt(cos theta)
 * pattern  float (CLR_PATTERN_NODES)  field over sin(angle to boresight / 2)
 * leg      float (n_m, n_padded / 8, n, PARTS, 8)  out */
__kernel void legs(const uint n, const uint first, const uint n_padded, const uint n_m, const uint n_groups,
                   const uint random_phase, const uint seed_low, const uint seed_high,
                   __global const float *antenna, __global const float *point, __global const int *cube,
                   __global const float *centre, __global const uchar *visible, __global const float *k,
                   __global const float *material, __global const float *pattern, __global float *leg) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, i = (uint)get_global_id(1);
    if (column >= n_padded || i >= n) return;
    __global const float *p = point + (size_t)CLR_POINT * (first + i), *a = antenna + column;
    __global const float *c = centre + 3 * (size_t)cube[first + i];
    const realw dx = (c[0] - LOADW(a)) - LOADW(a + 3 * n_padded);
    const realw dy = (c[1] - LOADW(a + n_padded)) - LOADW(a + 4 * n_padded);
    const realw dz = (c[2] - LOADW(a + 2 * n_padded)) - LOADW(a + 5 * n_padded);
    const realw x = dx + p[OFFSET], y = dy + p[OFFSET + 1], z = dz + p[OFFSET + 2];
    const realw length = sqrt(x * x + y * y + z * z), sum = length + sqrt(dx * dx + dy * dy + dz * dz);
    /* |d + o| - |d|, without cancellation. */
    const realw longer = (p[OFFSET] * (dx + x) + p[OFFSET + 1] * (dy + y) + p[OFFSET + 2] * (dz + z)) / sum;
    const realw inverse = 1.0f / length;
    const realw along = -(x * p[VECTOR] + y * p[VECTOR + 1] + z * p[VECTOR + 2]) * inverse;
    const realw damping = -39.478417604357f * ((x * p[SLOPE] + y * p[SLOPE + 1] + z * p[SLOPE + 2]) * inverse + p[LEVEL]);
    realw field = inverse;
#if CLR_PATTERN
    const realw ahead = x * LOADW(a + 6 * n_padded) + y * LOADW(a + 7 * n_padded) + z * LOADW(a + 8 * n_padded);
    const realw half_square = 0.5f - 0.5f * ahead * inverse;
    field *= looked_up(pattern, 1, CLR_PATTERN_NODES, sqrt(greater(half_square, (realw)(0.0f))));
#endif
    if (n_groups) {
        const uint bits = visible[(size_t)(first + i) * n_groups + column / BLOCK] >> (column % BLOCK);
        const intw seen = (((intw)((int)bits) >> TO_INTW(LANE_INDEX)) & 1) != 0;
        field = choose(seen, field, (realw)(0.0f));
    }
#if CLR_MATERIALS
    const float area = length3(load3(p + VECTOR));
    const realw slant = sqrt(greater(along / area, (realw)(0.0f)));
    __global const float *g = material + (size_t)((__global const int *)p)[MATERIAL] * n_m * CLR_NODES * 3;
#endif
#if CLR_TERMS == 3
    /* sqrt(w / pi) zeta, on one side only; zeta is complex normal with E |zeta|^2 = 1. */
    float zeta_re = 1.0f, zeta_im = 0.0f;
    if (random_phase) {
        const uint4 r = draw(((__global const uint *)p)[SAMPLE], 0, 0, DOMAIN_MICRO, seed_low, seed_high);
        const float size = sqrt(-log(unit_interval(r.x)) * area * 0.3183098861837907f);
        realw cosine, sine;
        cos_sin_cycles((realw)(unit_interval(r.y)), &cosine, &sine);
        zeta_re = size * LANE(cosine, 0);
        zeta_im = size * LANE(sine, 0);
    }
#endif
    const size_t step = (size_t)PARTS * BLOCK * n * (n_padded / BLOCK);
    __global float *out = leg + ((size_t)(column / BLOCK) * n + i) * PARTS * BLOCK + column % BLOCK;
    const realw magic = 12582912.0f;
    for (uint m = 0; m < n_m; ++m) {
        const realw turns = longer * k[m];
        realw cosine, sine;
        cos_sin_cycles(turns - ((turns + magic) - magic), &cosine, &sine);
        realw re = field * cosine, im = -field * sine;
#if CLR_TERMS == 3
        const realw micro = looked_up(g + 2, 3, CLR_NODES, slant);
        const realw rough_re = micro * re, rough_im = micro * im;
        STOREW(rough_re * zeta_re - rough_im * zeta_im, out + 4 * BLOCK);
        STOREW(rough_re * zeta_im + rough_im * zeta_re, out + 5 * BLOCK);
#endif
        if (p[LEVEL] > 0.0f) { /* else the slope is 0, too */
            const realw spread = damping * (k[m] * k[m]); /* exp(-spread), to second order */
            const realw mean = 1.0f / (1.0f + spread * (1.0f + 0.5f * spread));
            re *= mean;
            im *= mean;
        }
#if CLR_MATERIALS
        const realw g_re = looked_up(g, 3, CLR_NODES, slant), g_im = looked_up(g + 1, 3, CLR_NODES, slant);
        const realw turned = re * g_re - im * g_im;
        im = re * g_im + im * g_re;
        re = turned;
        g += 3 * CLR_NODES;
#endif
        STOREW(along * re, out);
        STOREW(along * im, out + BLOCK);
        STOREW(re, out + 2 * BLOCK);
        STOREW(im, out + 3 * BLOCK);
        out += step;
    }
}

/* Where the sums of a Tx and CLR_WIDTH Rx are, of `at` counted over the frequencies of all cubes. */
static inline __global float *sum_of(__global float *sum, const uint row, const uint column, const uint n_rx,
                                     const uint n_cubes, const uint at, const uint n_m) {
    const size_t pair = (size_t)row * (n_rx / BLOCK) + column / BLOCK;
    return sum + (pair * n_cubes * n_m + at) * 2 * BLOCK + column % BLOCK;
}

/* Sum the products of legs over the points of each cube. Item = ROWS Tx and CLR_WIDTH Rx at one frequency of one cube.
 *
 * start   uint (n_cubes + 1)  first point of each cube among all
 * first, n                    points whose legs are there; they are in n_here cubes from first_cube on
 * tx, rx  float (n_m, n_tx / 8, n, PARTS, 8), the same for rx
 * sum     float (n_tx, n_rx / 8, n_cubes, n_m, 2, 8)   in and out */
__kernel void add_products(const uint first, const uint n, const uint first_cube, const uint n_here,
                           const uint n_cubes, const uint n_m, const uint n_tx, const uint n_rx,
                           __global const uint *start, __global const float *tx, __global const float *rx,
                           __global float *sum) {
    const uint row = (uint)get_global_id(0) * ROWS, column = (uint)get_global_id(1) * CLR_WIDTH;
    const uint at = (uint)get_global_id(2), cube = first_cube + at / n_m, m = at % n_m;
    if (row >= n_tx || column >= n_rx || at >= n_here * n_m) return;
    const uint low = start[cube] > first ? start[cube] - first : 0;
    const uint high = start[cube + 1] < first + n ? start[cube + 1] - first : n;
    __global float *out = sum_of(sum, row, column, n_rx, n_cubes, cube * n_m + m, n_m);
    const size_t next = (size_t)(n_rx / BLOCK) * n_cubes * n_m * 2 * BLOCK;
    __global const float *a = tx + (((size_t)m * (n_tx / BLOCK) + row / BLOCK) * n + low) * PARTS * BLOCK + row % BLOCK;
    __global const float *b = rx + (((size_t)m * (n_rx / BLOCK) + column / BLOCK) * n + low) * PARTS * BLOCK +
                              column % BLOCK;
    realw re[ROWS], im[ROWS];
#pragma unroll
    for (uint i = 0; i < ROWS; ++i) {
        re[i] = LOADW(out + i * next);
        im[i] = LOADW(out + i * next + BLOCK);
    }
#define TERM(of_tx, of_rx)                                                                                     \
    {                                                                                                          \
        const realw b_re = LOADW(b + (of_rx) * BLOCK), b_im = LOADW(b + ((of_rx) + 1) * BLOCK);                \
        _Pragma("unroll") for (uint i = 0; i < ROWS; ++i) {                                                    \
            const realw a_re = a[(of_tx) * BLOCK + i], a_im = a[((of_tx) + 1) * BLOCK + i];                    \
            re[i] = fused(a_re, b_re, fused(-a_im, b_im, re[i]));                                              \
            im[i] = fused(a_re, b_im, fused(a_im, b_re, im[i]));                                               \
        }                                                                                                      \
    }
    for (uint p = low; p < high; ++p) {
        TERM(0, 2)
        TERM(2, 0)
#if CLR_TERMS == 3
        TERM(4, 4)
#endif
        a += PARTS * BLOCK;
        b += PARTS * BLOCK;
    }
#pragma unroll
    for (uint i = 0; i < ROWS; ++i) {
        STOREW(re[i], out + i * next);
        STOREW(im[i], out + i * next + BLOCK);
    }
}

/* From skeleton Rx to all. Item = CLR_WIDTH Rx of one skeleton Tx at one frequency of one cube.
 *
 * sum     float (n_rows, n_skeleton / 8, n, 2, 8)   n counts frequencies of cubes
 * weights float (n_skeleton, n_rx)
 * out     float (n, n_rows, 2, n_rx) */
__kernel void spread_columns(const uint n, const uint n_rows, const uint n_skeleton, const uint n_rx,
                             __global const float *sum, __global const float *weights, __global float *out) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, row = (uint)get_global_id(1);
    const uint at = (uint)get_global_id(2);
    if (column >= n_rx || row >= n_rows || at >= n) return;
    realw re = 0.0f, im = 0.0f;
    for (uint j = 0; j < n_skeleton; ++j) {
        const size_t pair = (size_t)row * (n_skeleton / BLOCK) + j / BLOCK;
        __global const float *in = sum + (pair * n + at) * 2 * BLOCK + j % BLOCK;
        const realw w = LOADW(weights + (size_t)j * n_rx + column);
        re = fused(w, (realw)(in[0]), re);
        im = fused(w, (realw)(in[BLOCK]), im);
    }
    __global float *to = out + ((size_t)at * n_rows + row) * 2 * n_rx + column;
    STOREW(re, to);
    STOREW(im, to + n_rx);
}

/* From skeleton Tx to all, added to what is there. Item = CLR_WIDTH Rx of ROWS Tx at one frequency of one cube.
 *
 * in      float (n, n_skeleton, 2, n_rx)
 * weights float (n_skeleton, n_tx)
 * sum     float (n_tx, n_rx / 8, n, 2, 8)   in and out */
__kernel void spread_rows(const uint n, const uint n_skeleton, const uint n_tx, const uint n_rx,
                          __global const float *in, __global const float *weights, __global float *sum) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, row = (uint)get_global_id(1) * ROWS;
    const uint at = (uint)get_global_id(2);
    if (column >= n_rx || row >= n_tx || at >= n) return;
    __global const float *from = in + (size_t)at * n_skeleton * 2 * n_rx + column;
    __global float *to = sum_of(sum, row, column, n_rx, n, at, 1);
    const size_t next = (size_t)(n_rx / BLOCK) * n * 2 * BLOCK;
    realw re[ROWS], im[ROWS];
    for (uint i = 0; i < ROWS; ++i) {
        re[i] = LOADW(to + i * next);
        im[i] = LOADW(to + i * next + BLOCK);
    }
    for (uint j = 0; j < n_skeleton; ++j) {
        const realw x = LOADW(from + 2 * j * (size_t)n_rx), y = LOADW(from + (2 * j + 1) * (size_t)n_rx);
        __global const float *w = weights + (size_t)j * n_tx + row;
#pragma unroll
        for (uint i = 0; i < ROWS; ++i) {
            re[i] = fused(x, (realw)(w[i]), re[i]);
            im[i] = fused(y, (realw)(w[i]), im[i]);
        }
    }
    for (uint i = 0; i < ROWS; ++i) {
        STOREW(re[i], to + i * next);
        STOREW(im[i], to + i * next + BLOCK);
    }
}

/* exp(-j k R) from the middles of cubes to the antennas of one side. Item = CLR_WIDTH antennas, one frequency, one cube.
 *
 * k      float (2, n_f)            cycles per metre as hi, then lo
 * phase  float (n_padded / 8, n_f, n_cubes, 2, 8)  out */
__kernel void centre_phases(const uint n_padded, const uint n_f, const uint n_cubes, __global const float *antenna,
                            __global const float *centre, __global const float *k, __global float *phase) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, cube = (uint)get_global_id(1);
    if (column >= n_padded || cube >= n_cubes) return;
    __global const float *a = antenna + column, *c = centre + 3 * cube;
    const realw none = 0.0f;
    const dual length = dual_length(
        dual_difference((realw)(c[0]), none, LOADW(a), LOADW(a + 3 * n_padded)),
        dual_difference((realw)(c[1]), none, LOADW(a + n_padded), LOADW(a + 4 * n_padded)),
        dual_difference((realw)(c[2]), none, LOADW(a + 2 * n_padded), LOADW(a + 5 * n_padded)));
    for (uint f = 0; f < n_f; ++f) {
        realw cosine, sine;
        cos_sin_cycles(cycles(length, make_wavenumber((realw)(k[f]), (realw)(k[n_f + f]))), &cosine, &sine);
        __global float *to = phase + (((size_t)(column / BLOCK) * n_f + f) * n_cubes + cube) * 2 * BLOCK + column % BLOCK;
        STOREW(cosine, to);
        STOREW(-sine, to + BLOCK);
    }
}

/* Add the cubes at all frequencies. Item = FREQUENCIES frequencies of one Tx and CLR_WIDTH Rx.
 *
 * sum     float (n_tx, n_rx / 8, n_cubes, n_m, 2, 8)
 * weights float (n_m, n_f)   n_f a multiple of FREQUENCIES
 * tx, rx  float (n_tx / 8, n_f, n_cubes, 2, 8), the same for rx: phases of the middles
 * capture float (n_tx, n_f, 2, n_rx)   in and out */
__kernel void add_cubes(const uint n_cubes, const uint n_m, const uint n_f, const uint n_tx, const uint n_rx,
                        __global const float *sum, __global const float *weights, __global const float *tx,
                        __global const float *rx, __global float *capture) {
    const uint f = (uint)get_global_id(0) * FREQUENCIES, row = (uint)get_global_id(1);
    const uint column = (uint)get_global_id(2) * CLR_WIDTH;
    if (f >= n_f || row >= n_tx || column >= n_rx) return;
    __global float *out = capture + ((size_t)row * n_f + f) * 2 * n_rx + column;
    __global const float *a = tx + ((size_t)(row / BLOCK) * n_f + f) * n_cubes * 2 * BLOCK + row % BLOCK;
    __global const float *b = rx + ((size_t)(column / BLOCK) * n_f + f) * n_cubes * 2 * BLOCK + column % BLOCK;
    const size_t step = (size_t)n_cubes * 2 * BLOCK;
    realw re[FREQUENCIES], im[FREQUENCIES];
#pragma unroll
    for (uint i = 0; i < FREQUENCIES; ++i) {
        re[i] = LOADW(out + 2 * i * (size_t)n_rx);
        im[i] = LOADW(out + (2 * i + 1) * (size_t)n_rx);
    }
    __global const float *s =
        sum + ((size_t)row * (n_rx / BLOCK) + column / BLOCK) * n_cubes * n_m * 2 * BLOCK + column % BLOCK;
    for (uint cube = 0; cube < n_cubes; ++cube) {
        realw x[FREQUENCIES], y[FREQUENCIES];
#pragma unroll
        for (uint i = 0; i < FREQUENCIES; ++i) x[i] = y[i] = 0.0f;
        for (uint m = 0; m < n_m; ++m) {
            const realw s_re = LOADW(s), s_im = LOADW(s + BLOCK);
            __global const float *w = weights + (size_t)m * n_f + f;
#pragma unroll
            for (uint i = 0; i < FREQUENCIES; ++i) {
                x[i] = fused(s_re, (realw)(w[i]), x[i]);
                y[i] = fused(s_im, (realw)(w[i]), y[i]);
            }
            s += 2 * BLOCK;
        }
#pragma unroll
        for (uint i = 0; i < FREQUENCIES; ++i) {
            const realw b_re = LOADW(b + i * step), b_im = LOADW(b + i * step + BLOCK);
            const realw a_re = a[i * step], a_im = a[i * step + BLOCK];
            const realw p_re = a_re * b_re - a_im * b_im, p_im = a_re * b_im + a_im * b_re;
            re[i] = fused(x[i], p_re, fused(-y[i], p_im, re[i]));
            im[i] = fused(x[i], p_im, fused(y[i], p_re, im[i]));
        }
        a += 2 * BLOCK;
        b += 2 * BLOCK;
    }
#pragma unroll
    for (uint i = 0; i < FREQUENCIES; ++i) {
        STOREW(re[i], out + 2 * i * (size_t)n_rx);
        STOREW(im[i], out + (2 * i + 1) * (size_t)n_rx);
    }
}

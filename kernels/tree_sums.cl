/* Sums over rows, columns and frequencies of blocks, down the tree (backproject_fast.cl) and up (forward_fast.cl):
 * one program whatever the smallest blocks hold, since compiling it takes a second.
 *
 * G  float (n_blocks, n_m, n_rows, 2, n_columns): real and imaginary parts of a row side by side; rows
 *    are padded with zeros to a multiple of CLR_WIDTH and of CLR_TILE columns. */
#ifndef CLR_ROWS
#error "CLR_ROWS (most rows of a block: they are held in private memory) is missing"
#endif
#if !defined(CLR_TILE) || CLR_TILE != 4
#error "CLR_TILE (weighted sums per pass over the rows) must be 4: sums are stored as float4"
#endif

#include "common/block_phases.h"

/* Rows of one block and frequency, CLR_WIDTH columns of them, times their phasors where there are any. A CPU holds
 * them in private memory for all sums; a GPU, where that would be far away, reads them again. */
typedef struct {
    __global const float *g, *phasors;
    uint n_columns, n_phasors;
#if CLR_WIDTH == 8
    realw re[CLR_ROWS], im[CLR_ROWS];
#endif
} row_set;

static inline void read_row(const row_set *rows, const uint i, realw *re, realw *im) {
    const realw a = LOADW(rows->g + (size_t)2 * i * rows->n_columns);
    const realw b = LOADW(rows->g + (size_t)(2 * i + 1) * rows->n_columns);
    *re = a;
    *im = b;
    if (!rows->phasors) return;
    const realw cosine = rows->phasors[i], sine = rows->phasors[rows->n_phasors + i];
    *re = fused(a, cosine, -(b * sine));
    *im = fused(a, sine, b * cosine);
}

/* To be called before sum_rows. */
static inline void hold_rows(row_set *rows, const uint n_rows) {
#if CLR_WIDTH == 8
    for (uint i = 0; i < n_rows; ++i) read_row(rows, i, rows->re + i, rows->im + i);
#endif
}

/* Sums over the rows, weighted with CLR_TILE neighbouring columns of the weights. */
typedef struct {
    realw re[CLR_TILE], im[CLR_TILE];
} weighted_sums;

static inline weighted_sums sum_rows(const uint n_rows, const row_set *rows,
                                     __global const float *weights, const uint n_weights) {
    weighted_sums sum;
#pragma unroll
    for (uint t = 0; t < CLR_TILE; ++t) sum.re[t] = sum.im[t] = 0.0f;
    for (uint i = 0; i < n_rows; ++i) {
        __global const float *w = weights + (size_t)i * n_weights;
#if CLR_WIDTH == 8
        const realw a = rows->re[i], b = rows->im[i];
#else
        realw a, b;
        read_row(rows, i, &a, &b);
#endif
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) {
            sum.re[t] = fused(a, (realw)(w[t]), sum.re[t]);
            sum.im[t] = fused(b, (realw)(w[t]), sum.im[t]);
        }
    }
    return sum;
}

/* Columns of weighted sums become rows: lane l of sum t goes to number t of row l.
 *
 * out  float (n_rows, 2, n_out)                CLR_TILE numbers from here on, in each of the first n_rows rows */
static inline void store_transposed(const weighted_sums sum, const uint n_rows, const uint n_out,
                                    __global float *out) {
#define FOUR(part, lane) (float4)(part[0] lane, part[1] lane, part[2] lane, part[3] lane)
#define STORE_LANE(number, lane)                                                                   \
    if (number < n_rows) {                                                                         \
        __global float *at = out + (size_t)2 * number * n_out;                                     \
        ((__global loose4 *)at)->v = FOUR(sum.re, lane);                                           \
        ((__global loose4 *)(at + n_out))->v = FOUR(sum.im, lane);                                 \
    }
#if CLR_WIDTH == 8
    STORE_LANE(0, .s0)
    STORE_LANE(1, .s1)
    STORE_LANE(2, .s2)
    STORE_LANE(3, .s3)
    STORE_LANE(4, .s4)
    STORE_LANE(5, .s5)
    STORE_LANE(6, .s6)
    STORE_LANE(7, .s7)
#else
    STORE_LANE(0, )
#endif
}

/* The phasors that refer the samples of CLR_WIDTH antennas from the centre p of a block to that of a block
 * in it, c. Arguments as below. */
static inline void antenna_phasors(const uint n_columns, const uint n_m,
                                   __global const float *antennas, __global const float *k,
                                   __global const float *c, __global const float *p,
                                   __global float *out) {
    const realw ax = LOADW(antennas), ay = LOADW(antennas + n_columns);
    const realw az = LOADW(antennas + 2 * n_columns);
#if CLR_FAR
    const realw bx = LOADW(antennas + 3 * n_columns);
    const realw by = LOADW(antennas + 4 * n_columns);
    const realw bz = LOADW(antennas + 5 * n_columns), none = 0.0f;
    const dual length = length_difference(
        from_antenna(c[0], none, ax, bx), from_antenna(c[1], none, ay, by),
        from_antenna(c[2], none, az, bz), from_antenna(p[0], none, ax, bx),
        from_antenna(p[1], none, ay, by), from_antenna(p[2], none, az, bz));
#else
    const realw px = p[0] - ax, py = p[1] - ay, pz = p[2] - az;
    const realw length =
        length_difference(c[0] - ax, c[1] - ay, c[2] - az, px, py, pz, c[0] - p[0], c[1] - p[1],
                          c[2] - p[2], sqrt(px * px + py * py + pz * pz));
#endif
    for (uint m = 0; m < n_m; ++m) {
        realw cosine, sine;
        phasor(length, k[m], k[n_m + m], &cosine, &sine);
        STOREW(cosine, out);
        STOREW(sine, out + n_columns);
        out += 2 * n_columns;
    }
}

/* The phasors that refer each antenna's samples from a block's centre to that of a block in it. Item =
 * CLR_WIDTH antennas of one block.
 *
 * antennas  float (6, n_columns)               x, y, z as hi, then as lo, metres; n_columns a multiple of
 *                                              CLR_WIDTH
 * k         float (2, n_m)                     cycles per metre as hi, then lo
 * centres   float (n_blocks, 3)                metres
 * parents   float (n_parents, 3)
 * parent    int (n_blocks)
 * phasors   float (n_blocks, n_m, 2, n_columns)  out: cosine, sine */
__kernel void block_phasors(const uint n_columns, const uint n_blocks, const uint n_m,
                          __global const float *antennas, __global const float *k,
                          __global const float *centres, __global const float *parents,
                          __global const int *parent, __global float *phasors) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, block = (uint)get_global_id(1);
    if (column >= n_columns || block >= n_blocks) return;
    antenna_phasors(n_columns, n_m, antennas + column, k, centres + 3 * block,
                    parents + 3 * parent[block],
                    phasors + (size_t)2 * block * n_m * n_columns + column);
}

/* CLR_WIDTH columns of one frequency become rows: arguments as below, from this block, frequency and column
 * on; n_left columns from here on are real. */
static inline void transposed_columns(const uint n_columns, const uint n_rows, const uint n_out,
                                      const uint n_left, const uint n_phasors,
                                      __global const float *g, __global const float *phasors,
                                      __global const float *weights, __global float *out) {
    row_set rows;
    rows.g = g;
    rows.phasors = phasors;
    rows.n_columns = n_columns;
    rows.n_phasors = n_phasors;
    hold_rows(&rows, n_rows);
#if CLR_WIDTH == 8
    /* CLR_WIDTH sums of a column side by side, which nothing has to transpose. */
    for (uint t0 = 0; t0 < CLR_WIDTH && t0 < n_left; t0 += CLR_TILE)
        for (uint j = 0; j < n_out; j += CLR_WIDTH) {
            weighted_sums sum;
#pragma unroll
            for (uint t = 0; t < CLR_TILE; ++t) sum.re[t] = sum.im[t] = 0.0f;
            for (uint i = 0; i < n_rows; ++i) {
                const realw w = LOADW(weights + (size_t)i * n_out + j);
                const float *a = (const float *)&rows.re[i] + t0;
                const float *b = (const float *)&rows.im[i] + t0;
#pragma unroll
                for (uint t = 0; t < CLR_TILE; ++t) {
                    sum.re[t] = fused((realw)(a[t]), w, sum.re[t]);
                    sum.im[t] = fused((realw)(b[t]), w, sum.im[t]);
                }
            }
#pragma unroll
            for (uint t = 0; t < CLR_TILE; ++t) {
                if (t0 + t >= n_left) continue;
                STOREW(sum.re[t], out + (size_t)2 * (t0 + t) * n_out + j);
                STOREW(sum.im[t], out + (size_t)(2 * (t0 + t) + 1) * n_out + j);
            }
        }
#else
    for (uint j = 0; j < n_out; j += CLR_TILE) {
        const weighted_sums sum = sum_rows(n_rows, &rows, weights + j, n_out);
        store_transposed(sum, n_left, n_out, out + j);
    }
#endif
}

/* Multiply the rows by their phasors and reduce their number; the result's rows are the old columns.
 * Item = CLR_WIDTH columns of one frequency of one block.
 *
 * g        float (n_parents, n_m, n_rows, 2, n_columns)
 * parent   int (n_blocks)
 * phasors  float (n_blocks, n_m, 2, n_phasors)
 * weights  float (n_rows, n_out)               n_out a multiple of CLR_TILE and of CLR_WIDTH
 * result   float (n_blocks, n_m, n_real_columns, 2, n_out)  out */
__kernel void reduce_and_transpose(const uint n_columns, const uint n_m, const uint n_blocks,
                                   const uint n_rows, const uint n_out,
                                   const uint n_real_columns, const uint n_phasors,
                                   __global const float *g, __global const int *parent,
                                   __global const float *phasors, __global const float *weights,
                                   __global float *result) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, m = (uint)get_global_id(1);
    const uint block = (uint)get_global_id(2);
    if (column >= n_real_columns || m >= n_m || block >= n_blocks) return;
    transposed_columns(n_columns, n_rows, n_out, n_real_columns - column, n_phasors,
                       g + ((size_t)parent[block] * n_m + m) * 2 * n_rows * n_columns + column,
                       phasors + ((size_t)block * n_m + m) * 2 * n_phasors, weights,
                       result +
                           (((size_t)block * n_m + m) * n_real_columns + column) * 2 * n_out);
}

/* CLR_WIDTH columns of one frequency with fewer rows: arguments as below, from this block, frequency and
 * column on. */
static inline void fewer_rows(const uint n_columns, const uint n_rows, const uint n_out,
                              const uint n_padded, const uint n_phasors, __global const float *g,
                              __global const float *phasors, __global const float *weights,
                              __global float *out) {
    row_set rows;
    rows.g = g;
    rows.phasors = phasors;
    rows.n_columns = n_columns;
    rows.n_phasors = n_phasors;
    hold_rows(&rows, n_rows);
    for (uint j = 0; j < n_padded; j += CLR_TILE) {
        const weighted_sums sum = sum_rows(n_rows, &rows, weights + j, n_padded);
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) {
            if (j + t >= n_out) continue;
            STOREW(sum.re[t], out + (size_t)2 * (j + t) * n_columns);
            STOREW(sum.im[t], out + (size_t)(2 * (j + t) + 1) * n_columns);
        }
    }
}

/* Multiply the rows by their phasors and reduce their number; columns stay columns. Arguments as above,
 * but every block has its own g, and result is float (n_blocks, n_m, n_out, 2, n_columns); weights have
 * n_padded columns, a multiple of CLR_TILE. */
__kernel void reduce_rows(const uint n_columns, const uint n_m, const uint n_blocks,
                          const uint n_rows, const uint n_out, const uint n_padded,
                          const uint n_phasors, __global const float *g,
                          __global const float *phasors, __global const float *weights,
                          __global float *result) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, m = (uint)get_global_id(1);
    const uint block = (uint)get_global_id(2);
    if (column >= n_columns || m >= n_m || block >= n_blocks) return;
    const size_t at = (size_t)block * n_m + m;
    fewer_rows(n_columns, n_rows, n_out, n_padded, n_phasors, g + at * 2 * n_rows * n_columns + column,
               phasors + at * 2 * n_phasors, weights, result + at * 2 * n_out * n_columns + column);
}

/* CLR_WIDTH numbers of fewer frequencies: arguments as below, from this block and number on. */
static inline void fewer_frequencies(const uint n_values, const uint n_m, const uint n_out,
                                     const uint n_padded, __global const float *in,
                                     __global const float *weights, __global float *out) {
    for (uint j = 0; j < n_padded; j += CLR_TILE) {
        realw sum[CLR_TILE];
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) sum[t] = 0.0f;
        for (uint m = 0; m < n_m; ++m) {
            __global const float *w = weights + (size_t)m * n_padded + j;
            const realw a = LOADW(in + (size_t)m * n_values);
#pragma unroll
            for (uint t = 0; t < CLR_TILE; ++t) sum[t] = fused(a, (realw)(w[t]), sum[t]);
        }
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t)
            if (j + t < n_out) STOREW(sum[t], out + (size_t)(j + t) * n_values);
    }
}

/* Reduce the number of frequencies. Item = CLR_WIDTH numbers of one block.
 *
 * g        float (n_blocks, n_m, n_values)     n_values a multiple of CLR_WIDTH
 * weights  float (n_m, n_padded)               n_padded a multiple of CLR_TILE
 * result   float (n_blocks, n_out, n_values)   out */
__kernel void reduce_frequencies(const uint n_values, const uint n_blocks, const uint n_m,
                                 const uint n_out, const uint n_padded, __global const float *g,
                                 __global const float *weights, __global float *result) {
    const uint value = (uint)get_global_id(0) * CLR_WIDTH, block = (uint)get_global_id(1);
    if (value >= n_values || block >= n_blocks) return;
    fewer_frequencies(n_values, n_m, n_out, n_padded, g + (size_t)block * n_m * n_values + value,
                      weights, result + (size_t)block * n_out * n_values + value);
}

/* The same of 2 CLR_WIDTH numbers, whose sums need not wait for one another. */
static inline void fewer_frequencies_of_two(const uint n_values, const uint n_m, const uint n_out,
                                            const uint n_padded, __global const float *in,
                                            __global const float *weights, __global float *out) {
    for (uint j = 0; j < n_padded; j += CLR_TILE) {
        realw one[CLR_TILE], two[CLR_TILE];
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) one[t] = two[t] = 0.0f;
        for (uint m = 0; m < n_m; ++m) {
            __global const float *w = weights + (size_t)m * n_padded + j;
            const realw a = LOADW(in + (size_t)m * n_values);
            const realw b = LOADW(in + (size_t)m * n_values + CLR_WIDTH);
#pragma unroll
            for (uint t = 0; t < CLR_TILE; ++t) {
                one[t] = fused(a, (realw)(w[t]), one[t]);
                two[t] = fused(b, (realw)(w[t]), two[t]);
            }
        }
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) {
            if (j + t >= n_out) continue;
            STOREW(one[t], out + (size_t)(j + t) * n_values);
            STOREW(two[t], out + (size_t)(j + t) * n_values + CLR_WIDTH);
        }
    }
}

/* All of the above, block by block: what one block needs on the way stays in a core's cache, and the three
 * steps are one launch. Item = every n_items-th block. For devices whose items are a core's lanes.
 *
 * n_columns, n_rows, n_skeleton                columns and rows of the parents, and columns left
 * n_new, n_new_rows                            rows left, padded: the columns of the result
 * row_antennas, column_antennas, centres, parents, parent, k   see block_phasors
 * g              float (n_parents, n_m, n_rows, 2, padded n_columns)
 * scratch        float (n_items, n_scratch)
 * result         float (n_blocks, n_left, n_skeleton, 2, n_new)  out */
__kernel void reduce_blocks(const uint n_items, const uint n_blocks, const uint n_m,
                            const uint n_rows, const uint n_columns, const uint n_new,
                            const uint n_skeleton, const uint n_left, const uint n_scratch,
                            __global const float *row_antennas,
                            __global const float *column_antennas, __global const float *k,
                            __global const float *centres, __global const float *parents,
                            __global const int *parent, __global const float *g,
                            __global const float *row_weights,
                            __global const float *column_weights,
                            __global const float *frequency_weights, __global float *scratch,
                            __global float *result) {
    const uint item = (uint)get_global_id(0);
    if (item >= n_items) return;
    const uint unit = CLR_WIDTH > CLR_TILE ? CLR_WIDTH : CLR_TILE;
    const uint n_row_phasors = (n_rows + unit - 1) / unit * unit;
    const uint n_padded_columns = (n_columns + unit - 1) / unit * unit;
    const uint n_padded_skeleton = (n_skeleton + CLR_TILE - 1) / CLR_TILE * CLR_TILE;
    const uint n_padded_left = (n_left + CLR_TILE - 1) / CLR_TILE * CLR_TILE;
    const uint n_values = 2 * n_skeleton * n_new;
    __global float *row_phasors = scratch + (size_t)item * n_scratch;
    __global float *column_phasors = row_phasors + 2 * n_m * n_row_phasors;
    __global float *transposed = column_phasors + 2 * n_m * n_padded_columns;
    __global float *reduced = transposed + 2 * n_columns * n_new;
    for (uint block = item; block < n_blocks; block += n_items) {
        __global const float *c = centres + 3 * block, *p = parents + 3 * parent[block];
        for (uint at = 0; at < n_row_phasors; at += CLR_WIDTH)
            antenna_phasors(n_row_phasors, n_m, row_antennas + at, k, c, p, row_phasors + at);
        for (uint at = 0; at < n_padded_columns; at += CLR_WIDTH)
            antenna_phasors(n_padded_columns, n_m, column_antennas + at, k, c, p,
                            column_phasors + at);
        for (uint m = 0; m < n_m; ++m) {
            __global const float *from =
                g + ((size_t)parent[block] * n_m + m) * 2 * n_rows * n_padded_columns;
            for (uint at = 0; at < n_columns; at += CLR_WIDTH)
                transposed_columns(n_padded_columns, n_rows, n_new, n_columns - at, n_row_phasors,
                                   from + at, row_phasors + 2 * m * n_row_phasors, row_weights,
                                   transposed + 2 * at * n_new);
            for (uint at = 0; at < n_new; at += CLR_WIDTH)
                fewer_rows(n_new, n_columns, n_skeleton, n_padded_skeleton, n_padded_columns,
                           transposed + at, column_phasors + 2 * m * n_padded_columns,
                           column_weights, reduced + (size_t)m * n_values + at);
        }
        /* n_values is twice a multiple of CLR_WIDTH. */
        for (uint at = 0; at < n_values; at += 2 * CLR_WIDTH)
            fewer_frequencies_of_two(n_values, n_m, n_left, n_padded_left, reduced + at,
                                     frequency_weights,
                                     result + (size_t)block * n_left * n_values + at);
    }
}

/* The reverse of reduce_rows: more rows, times the conjugates of their phasors; the result's rows are the old
 * columns. Item = CLR_WIDTH columns of one frequency of one block.
 *
 * g        float (n_blocks, n_m, n_rows, 2, n_columns)
 * phasors  float (n_blocks, n_m, 2, n_out)
 * weights  float (n_rows, n_out)               n_out a multiple of CLR_TILE and of CLR_WIDTH
 * result   float (n_blocks, n_m, n_real_columns, 2, n_out)  out */
__kernel void expand_and_transpose(const uint n_columns, const uint n_m, const uint n_blocks,
                                   const uint n_rows, const uint n_out, const uint n_real_columns,
                                   __global const float *g, __global const float *phasors,
                                   __global const float *weights, __global float *result) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, m = (uint)get_global_id(1);
    const uint block = (uint)get_global_id(2);
    if (column >= n_real_columns || m >= n_m || block >= n_blocks) return;
    const size_t at = (size_t)block * n_m + m;
    row_set rows;
    rows.g = g + at * 2 * n_rows * n_columns + column;
    rows.phasors = 0;
    rows.n_columns = n_columns;
    hold_rows(&rows, n_rows);
    __global const float *turn = phasors + at * 2 * n_out;
    __global float *out = result + (at * n_real_columns + column) * 2 * n_out;
    for (uint j = 0; j < n_out; j += CLR_TILE) {
        weighted_sums sum = sum_rows(n_rows, &rows, weights + j, n_out);
#pragma unroll
        for (uint t = 0; t < CLR_TILE; ++t) {
            const realw cosine = turn[j + t], sine = turn[n_out + j + t];
            const realw a = sum.re[t], b = sum.im[t];
            sum.re[t] = fused(a, cosine, b * sine);
            sum.im[t] = fused(b, cosine, -(a * sine));
        }
        store_transposed(sum, n_real_columns - column, n_out, out + j);
    }
}

/* The reverse of reduce_and_transpose: more rows, times the conjugates of their phasors, added up over the
 * blocks of each parent. Item = CLR_WIDTH columns of one frequency of one parent.
 *
 * g        float (n_blocks, n_m, n_rows, 2, n_columns)
 * ranges   int (n_parents, 3)                  the parent's first block, the one after its last, and whether
 *                                              the sums go on that result has already
 * phasors  float (n_blocks, n_m, 2, n_phasors)
 * weights  float (n_rows, n_padded)            n_padded a multiple of CLR_TILE
 * result   float (n_parents, n_m, n_out, 2, n_columns)  in and out, from the first of these parents on */
__kernel void expand_rows(const uint n_columns, const uint n_m, const uint n_parents,
                          const uint n_rows, const uint n_out, const uint n_padded,
                          const uint n_phasors, const uint first_parent, __global const float *g,
                          __global const int *ranges, __global const float *phasors,
                          __global const float *weights, __global float *result) {
    const uint column = (uint)get_global_id(0) * CLR_WIDTH, m = (uint)get_global_id(1);
    const uint parent = (uint)get_global_id(2);
    if (column >= n_columns || m >= n_m || parent >= n_parents) return;
    row_set rows;
    rows.phasors = 0;
    rows.n_columns = n_columns;
    const int begin = ranges[3 * parent], end = ranges[3 * parent + 1];
    int goes_on = ranges[3 * parent + 2];
    __global float *sums =
        result + ((size_t)(first_parent + parent) * n_m + m) * 2 * n_out * n_columns + column;
    for (int block = begin; block < end; ++block, goes_on = 1) {
        const size_t at = (size_t)block * n_m + m;
        rows.g = g + at * 2 * n_rows * n_columns + column;
        hold_rows(&rows, n_rows);
        __global const float *turn = phasors + at * 2 * n_phasors;
        for (uint j = 0; j < n_padded; j += CLR_TILE) {
            const weighted_sums sum = sum_rows(n_rows, &rows, weights + j, n_padded);
#pragma unroll
            for (uint t = 0; t < CLR_TILE; ++t) {
                if (j + t >= n_out) continue;
                const realw cosine = turn[j + t], sine = turn[n_phasors + j + t];
                __global float *out = sums + (size_t)2 * (j + t) * n_columns;
                const realw a = goes_on ? LOADW(out) : (realw)(0.0f);
                const realw b = goes_on ? LOADW(out + n_columns) : (realw)(0.0f);
                STOREW(fused(sum.re[t], cosine, fused(sum.im[t], sine, a)), out);
                STOREW(fused(sum.im[t], cosine, fused(-sum.re[t], sine, b)), out + n_columns);
            }
        }
    }
}

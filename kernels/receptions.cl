/* The receptions of a tile, which trace.cl appends in any order, by pair, then sample, ray and bounce: a counting sort
 * into bins, some successive samples of one pair each, and within a bin by how many come before. The host sums the
 * counts of the bins to the first slot of each. An item takes `share` receptions. */
#ifndef CLR_WIDTH
#error "CLR_WIDTH (lanes per work-item) is missing"
#endif

/* n        receptions, at most `capacity` of all buffers
 * key      ulong (n)            bin << 32 | (sample * rays + ray) * max_bounces + bounce
 * path     uint4 (n)            see trace.cl; w is the number of those in its bin that were appended before
 * start    uint (n_bins + 1)    first slot of each bin
 * within   uint (n)             out: lower half of the key at each slot
 * source   uint (n)             out: which reception it is */
__kernel void place_receptions(const uint n, const uint share, __global const ulong *key,
                               __global const uint4 *path, __global const uint *start,
                               __global uint *within, __global uint *source) {
    const uint first = (uint)get_global_id(0) * share;
    const uint last = n - first < share ? n : first + share;
    if (first >= n) return;
    for (uint i = first; i < last; ++i) {
        const uint slot = start[(uint)(key[i] >> 32)] + path[i].w;
        within[slot] = (uint)key[i];
        source[slot] = i;
    }
}

/* place      uint (n)   out: `within`, in order
 * length     uint2 (n)  out: float64 metres as lower and upper 32 bits
 * amplitude  float (n)  out */
__kernel void order_receptions(const uint n, const uint share, __global const ulong *key,
                               __global const uint4 *path, __global const uint *start,
                               __global const uint *within, __global const uint *source,
                               __global uint *place, __global uint2 *length,
                               __global float *amplitude) {
    const uint first = (uint)get_global_id(0) * share;
    const uint last = n - first < share ? n : first + share;
    if (first >= n) return;
    for (uint slot = first; slot < last; ++slot) {
        const uint i = source[slot], mine = within[slot], bin = (uint)(key[i] >> 32);
        const uint begin = start[bin], end = start[bin + 1];
        uint at = begin;
        for (uint other = begin; other < end; ++other) at += within[other] < mine;
        const uint4 row = path[i];
        place[at] = mine;
        length[at] = row.xy;
        amplitude[at] = as_float(row.z);
    }
}

/* The part of OpenCL C that the kernels use, for a compiler that comes without OpenCL's own headers. Functions of
 * a driver's library are stood in for by single instructions: their registers are not counted. */
#define inline __attribute__((always_inline)) /* as drivers do */
typedef unsigned char uchar;
typedef unsigned short ushort;
typedef unsigned int uint;
typedef unsigned long ulong;
typedef __SIZE_TYPE__ size_t;
#define VECTORS(type) \
    typedef type type##2 __attribute__((ext_vector_type(2))); \
    typedef type type##3 __attribute__((ext_vector_type(3))); \
    typedef type type##4 __attribute__((ext_vector_type(4))); \
    typedef type type##8 __attribute__((ext_vector_type(8)))
VECTORS(float);
VECTORS(int);
VECTORS(uint);
VECTORS(ulong);

#define FLT_MAX 0x1.fffffep+127f
#define INFINITY __builtin_inff()
#define as_int(x) __builtin_astype((x), int)
#define as_uint(x) __builtin_astype((x), uint)
#define as_float(x) __builtin_astype((x), float)
#define as_int8(x) __builtin_astype((x), int8)
#define as_float8(x) __builtin_astype((x), float8)
#define convert_int_rtz(x) ((int)(x))
#define convert_int8_rtz(x) __builtin_convertvector((x), int8)
#define convert_float8(x) __builtin_convertvector((x), float8)
#define sqrt(x) __builtin_elementwise_sqrt(x)
#define min(a, b) __builtin_elementwise_min(a, b)
#define max(a, b) __builtin_elementwise_max(a, b)
#define popcount(x) ((uint)__builtin_popcount(x))
#define clz(x) ((uint)__builtin_clz(x))
#define mul_hi(a, b) ((uint)((ulong)(a) * (b) >> 32))
#define atomic_add(p, v) __atomic_fetch_add(p, v, __ATOMIC_RELAXED)
#define atomic_inc(p) atomic_add(p, 1)
#define atomic_or(p, v) __atomic_fetch_or(p, v, __ATOMIC_RELAXED)

#if defined(__NVPTX__)
#define EXP2(x) __nvvm_ex2_approx_f(x)
#define LOG2(x) __nvvm_lg2_approx_f(x)
#define sin(x) __nvvm_sin_approx_f(x)
#define cos(x) __nvvm_cos_approx_f(x)
#define GLOBAL_ID(axis) \
    (__nvvm_read_ptx_sreg_ctaid_##axis() * __nvvm_read_ptx_sreg_ntid_##axis() + \
     __nvvm_read_ptx_sreg_tid_##axis())
#else
#define EXP2(x) __builtin_amdgcn_exp2f(x)
#define LOG2(x) __builtin_amdgcn_logf(x)
#define sin(x) __builtin_amdgcn_sinf((x) * 0.15915494f)
#define cos(x) __builtin_amdgcn_cosf((x) * 0.15915494f)
#define GLOBAL_ID(axis) \
    (__builtin_amdgcn_workgroup_id_##axis() * __builtin_amdgcn_workgroup_size_##axis() + \
     __builtin_amdgcn_workitem_id_##axis())
#endif
#define exp(x) EXP2((x) * 1.44269504f)
#define log(x) (LOG2(x) * 0.69314718f)
#define pow(x, y) EXP2((y) * LOG2(x))

static inline size_t get_global_id(const uint axis) {
    return axis == 0 ? GLOBAL_ID(x) : axis == 1 ? GLOBAL_ID(y) : GLOBAL_ID(z);
}

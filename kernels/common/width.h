/* Lanes per work-item, chosen when the program is built: 8 on a CPU, where wide vectors pay, and 1
 * on a GPU, where neighbouring items are the lanes. The same source serves both. */
#ifndef CLR_WIDTH
#error "CLR_WIDTH (lanes per work-item: 1 or 8) is missing"
#endif

/* Products and sums are fused only where the source says fma: error terms and the consistency of
 * neighbouring triangles rely on it, and results stay the same whatever the compiler likes. */
#pragma OPENCL FP_CONTRACT OFF

#if CLR_WIDTH == 8
typedef float8 realw;
typedef int8 intw;
#define LOADW(p) vload8(0, (p))
#define STOREW(v, p) vstore8((v), 0, (p))
#define AS_INTW(v) as_int8(v)
#define AS_REALW(v) as_float8(v)
#define LANE_INDEX ((realw)(0.0f, 1.0f, 2.0f, 3.0f, 4.0f, 5.0f, 6.0f, 7.0f))
#elif CLR_WIDTH == 1
typedef float realw;
typedef int intw;
#define LOADW(p) (*(p))
#define STOREW(v, p) (*(p) = (v))
#define AS_INTW(v) as_int(v)
#define AS_REALW(v) as_float(v)
#define LANE_INDEX (0.0f)
#else
#error "CLR_WIDTH must be 1 or 8"
#endif

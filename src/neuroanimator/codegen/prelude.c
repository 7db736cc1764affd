/* Prelude of generated programs: vectors of sixteen floats in C99, and elementary functions without branches, so that
   loops over them vectorise. Relative errors are a few units in the last place of float32. */
#include <math.h>
#include <string.h>

#define LANES 16

/* Clang would unroll each such loop before it vectorises it, and take minutes for a program. */
#if defined(__clang__)
#define NA_EACH_LANE _Pragma("clang loop unroll(disable)") for (int l = 0; l < LANES; l++)
#else
#define NA_EACH_LANE for (int l = 0; l < LANES; l++)
#endif

#if defined(_MSC_VER)
#define NA_RESTRICT __restrict
#define NA_ALIGNED __declspec(align(64))
#elif defined(__cplusplus)
#define NA_RESTRICT __restrict__
#define NA_ALIGNED __attribute__((aligned(64)))
#else
#define NA_RESTRICT restrict
#define NA_ALIGNED __attribute__((aligned(64)))
#endif

/* Storage of the arrays for sixteen lanes: the stack, unless defined as `static _Thread_local` (C++: `static thread_local`). */
#if !defined(NA_SCRATCH)
#define NA_SCRATCH
#endif

/* Sixteen floats: one register of AVX-512, two of AVX2, four of SSE, NEON and WASM, or none if the compiler has no vectors. */
#if !defined(__GNUC__) || defined(NA_PLAIN)
typedef struct { float lane[LANES]; } na_wide;
#define NA_ZERO(s) do { for (int l = 0; l < LANES; l++) (s).lane[l] = 0.0f; } while (0)
#define NA_ADD(s, x) do { for (int l = 0; l < LANES; l++) (s).lane[l] += (x).lane[l]; } while (0)
#define NA_MULTIPLY_ADD(s, x, f) do { for (int l = 0; l < LANES; l++) (s).lane[l] += (x).lane[l] * (f); } while (0)
#elif defined(__AVX512F__)
typedef float na_part __attribute__((vector_size(64), may_alias));
static const na_part na_zeros = {0}; /* C++ has no compound literals */
typedef struct { na_part a; } na_wide;
#define NA_ZERO(s) ((s).a = na_zeros)
#define NA_ADD(s, x) ((s).a += (x).a)
#define NA_MULTIPLY_ADD(s, x, f) ((s).a += (x).a * (f))
#elif defined(__AVX__)
typedef float na_part __attribute__((vector_size(32), may_alias));
static const na_part na_zeros = {0}; /* C++ has no compound literals */
typedef struct { na_part a, b; } na_wide;
#define NA_ZERO(s) ((s).a = (s).b = na_zeros)
#define NA_ADD(s, x) ((s).a += (x).a, (s).b += (x).b)
#define NA_MULTIPLY_ADD(s, x, f) ((s).a += (x).a * (f), (s).b += (x).b * (f))
#else
typedef float na_part __attribute__((vector_size(16), may_alias));
static const na_part na_zeros = {0}; /* C++ has no compound literals */
typedef struct { na_part a, b, c, d; } na_wide;
#define NA_ZERO(s) ((s).a = (s).b = (s).c = (s).d = na_zeros)
#define NA_ADD(s, x) ((s).a += (x).a, (s).b += (x).b, (s).c += (x).c, (s).d += (x).d)
#define NA_MULTIPLY_ADD(s, x, f) \
    ((s).a += (x).a * (f), (s).b += (x).b * (f), (s).c += (x).c * (f), (s).d += (x).d * (f))
#endif

/* Prefetches what is read soon: rows of weights are too far apart for the prefetchers of some processors. */
#if defined(__GNUC__)
#define NA_PREFETCH(address) __builtin_prefetch(address)
#else
#define NA_PREFETCH(address) ((void)0)
#endif

/* Number of columns summed in one pass of `na_lane_products`: as many sums as fit in registers, and enough that none
   waits for the one before it. Number of rows prefetched ahead. */
#if defined(__AVX512F__)
#define NA_SUMS 16
#else
#define NA_SUMS 4
#endif
#define NA_ROWS_AHEAD 8

/* y (columns, LANES): x (count, LANES) times the first `columns` of `weights` (count, stride). A weight is read once for all
   lanes. The number of columns written is rounded up to whole passes. */
static inline void na_lane_products(long columns, long count, long stride, const float *weights, const na_wide *x, na_wide *y) {
    for (long first = 0; first < columns; first += NA_SUMS) {
        const float *row = weights + first;
        na_wide sums[NA_SUMS];
        for (int j = 0; j < NA_SUMS; j++) NA_ZERO(sums[j]);
        for (long q = 0; q < count; q++, row += stride) {
            NA_PREFETCH(row + NA_ROWS_AHEAD * stride);
            for (int j = 0; j < NA_SUMS; j++) NA_MULTIPLY_ADD(sums[j], x[q], row[j]);
        }
        for (int j = 0; j < NA_SUMS; j++) y[first + j] = sums[j];
    }
}

/* The dot product of two vectors (count,), in LANES sums side by side. */
static inline float na_dot(long count, const float *x, const float *weights) {
    float sums[LANES] = {0}, sum = 0.0f;
    long q = 0;
    for (; q + LANES <= count; q += LANES)
        for (long l = 0; l < LANES; l++) sums[l] += x[q + l] * weights[q + l];
    for (long l = 0; l < count - q; l++) sums[l] += x[q + l] * weights[q + l];
    for (int l = 0; l < LANES; l++) sum += sums[l];
    return sum;
}

static inline float na_from_bits(int bits) {
    float number;
    memcpy(&number, &bits, sizeof number);
    return number;
}

static inline int na_to_bits(float number) {
    int bits;
    memcpy(&bits, &number, sizeof bits);
    return bits;
}

/* e^x = 2^n e^r with |r| <= ln(2)/2; Cody and Waite's reduction. Beyond 88 it stays finite. */
static inline float na_exp(float x) {
    x = x > 88.0f ? 88.0f : x;
    x = x < -87.0f ? -87.0f : x;
    const float n = rintf(x * 1.44269504f);
    const float r = x - n * 0.693359375f + n * 2.12194440e-4f;
    float p = 1.9875691500e-4f;
    p = p * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    /* NaN stays NaN; converted to int it would be undefined. */
    const int exponent = (int)(n == n ? n : 0.0f) + 127;
    return (p * r * r + r + 1.0f) * na_from_bits((int)((unsigned)exponent << 23));
}

static inline float na_logistic(float x) { return 1.0f / (1.0f + na_exp(-x)); }

/* A quotient of polynomials; beyond 7.9 it is 1 to the last place. */
static inline float na_tanh(float x) {
    x = x > 7.90531110763549805f ? 7.90531110763549805f : x;
    x = x < -7.90531110763549805f ? -7.90531110763549805f : x;
    const float s = x * x;
    float p = -2.76076847742355e-16f;
    p = p * s + 2.00018790482477e-13f;
    p = p * s + -8.60467152213735e-11f;
    p = p * s + 5.12229709037114e-08f;
    p = p * s + 1.48572235717979e-05f;
    p = p * s + 6.37261928875436e-04f;
    p = p * s + 4.89352455891786e-03f;
    float q = 1.19825839466702e-06f;
    q = q * s + 1.18534705686654e-04f;
    q = q * s + 2.26843463243900e-03f;
    q = q * s + 4.89352518554385e-03f;
    return x * p / q;
}

/* sin(x + quarters * pi / 2). Reduced in double, so that an angle of many turns is as accurate as a small one. */
static inline float na_sine(float x, int quarters) {
    const double n = rint((double)x * 0.63661977236758134308);
    const float r = (float)((double)x - n * 1.57079632679489661923);
    const int quarter = (int)(n == n ? n : 0.0) + quarters;
    const float s = r * r;
    const float sine = r + r * s * (-1.6666654611e-1f + s * (8.3321608736e-3f + s * -1.9515295891e-4f));
    const float cosine = 1.0f - 0.5f * s + s * s * (4.166664568298827e-2f + s * (-1.388731625493765e-3f + s * 2.443315711809948e-5f));
    const float size = quarter & 1 ? cosine : sine;
    return quarter & 2 ? -size : size;
}

static inline float na_sin(float x) { return na_sine(x, 0); }
static inline float na_cos(float x) { return na_sine(x, 1); }

/* Abramowitz and Stegun, 4.4.49. */
static inline float na_atan2(float y, float x) {
    const float a = fabsf(x);
    const float b = fabsf(y);
    const float larger = a > b ? a : b;
    const float smaller = a > b ? b : a;
    const float z = larger > 0.0f ? smaller / larger : larger;
    const float s = z * z;
    float p = 0.0028662257f;
    p = p * s + -0.0161657367f;
    p = p * s + 0.0429096138f;
    p = p * s + -0.0752896400f;
    p = p * s + 0.1065626393f;
    p = p * s + -0.1420889944f;
    p = p * s + 0.1999355085f;
    p = p * s + -0.3333314528f;
    float angle = z + z * s * p;
    angle = b > a ? 1.57079632679489661923f - angle : angle;
    angle = x < 0.0f ? 3.14159265358979323846f - angle : angle;
    return copysignf(angle, y);
}

static inline float na_log(float x) {
    int bits = na_to_bits(x);
    int exponent = (bits >> 23) - 126;
    float m = na_from_bits((bits & 0x007fffff) | 0x3f000000);
    const int is_low = m < 0.707106781186547524f;
    exponent -= is_low;
    m = (is_low ? m + m : m) - 1.0f;
    const float s = m * m;
    float p = 7.0376836292e-2f;
    p = p * m + -1.1514610310e-1f;
    p = p * m + 1.1676998740e-1f;
    p = p * m + -1.2420140846e-1f;
    p = p * m + 1.4249322787e-1f;
    p = p * m + -1.6668057665e-1f;
    p = p * m + 2.0000714765e-1f;
    p = p * m + -2.4999993993e-1f;
    p = p * m + 3.3333331174e-1f;
    const float n = (float)exponent;
    float y = m + (m * s * p + n * -2.12194440e-4f - 0.5f * s) + n * 0.693359375f;
    y = x > 0.0f ? y : -INFINITY;
    return x >= 0.0f ? y : NAN;
}

/* Eigenvectors (columns of v) and eigenvalues, ascending, of a symmetric (n, n) matrix with n <= 8: Jacobi's rotations. */
static inline void na_eigh(int n, const float *a, float *v, float *values) {
    double m[64], q[64];
    for (int i = 0; i < n * n; i++) {
        m[i] = a[i];
        q[i] = i % (n + 1) == 0;
    }
    for (int sweep = 0; sweep < 12; sweep++) {
        for (int i = 0; i < n - 1; i++) {
            for (int j = i + 1; j < n; j++) {
                const double off = m[i * n + j];
                if (fabs(off) < 1e-30) continue;
                const double ratio = (m[j * n + j] - m[i * n + i]) / (2 * off);
                const double tangent = (ratio < 0 ? -1 : 1) / (fabs(ratio) + sqrt(ratio * ratio + 1));
                const double cosine = 1 / sqrt(tangent * tangent + 1);
                const double sine = tangent * cosine;
                for (int r = 0; r < n; r++) {
                    const double left = m[r * n + i], right = m[r * n + j];
                    m[r * n + i] = cosine * left - sine * right;
                    m[r * n + j] = sine * left + cosine * right;
                }
                for (int r = 0; r < n; r++) {
                    const double upper = m[i * n + r], lower = m[j * n + r];
                    m[i * n + r] = cosine * upper - sine * lower;
                    m[j * n + r] = sine * upper + cosine * lower;
                    const double left = q[r * n + i], right = q[r * n + j];
                    q[r * n + i] = cosine * left - sine * right;
                    q[r * n + j] = sine * left + cosine * right;
                }
            }
        }
    }
    int used[8] = {0};
    for (int rank = 0; rank < n; rank++) {
        int least = -1;
        for (int i = 0; i < n; i++)
            if (!used[i] && (least < 0 || m[i * n + i] < m[least * n + least])) least = i;
        used[least] = 1;
        values[rank] = (float)m[least * n + least];
        for (int r = 0; r < n; r++) v[r * n + rank] = (float)q[r * n + least];
    }
}

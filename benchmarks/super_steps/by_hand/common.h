/* What a programmer who writes an emulator in C by hand begins with: vectors of sixteen floats, a product, a tanh. */
#include <math.h>
#include <string.h>

#define LANES 16
#define VECTORS(count) (((count) + LANES - 1) / LANES)
#define PADDED(count) (VECTORS(count) * LANES)
#define INLINE static inline __attribute__((always_inline))

typedef float vector __attribute__((vector_size(4 * LANES), aligned(4)));

#define AT(row, v) (*(const vector *)(w + (row) * stride + (v) * LANES))

/* Four, two or one vectors of y += x (rows) times w (rows, stride). Sums stay in registers, and rows are summed in parts, so
   that no addition waits for the one before; `rows` is a multiple of the parts, or its rest is done one by one. */
INLINE void four_vectors(const float *x, int rows, const float *w, int stride, float *y) {
    vector a = {0}, b = {0}, c = {0}, d = {0}, e = {0}, f = {0}, g = {0}, h = {0};
    int row = 0;
    for (; row + 2 <= rows; row += 2) {
        a += x[row] * AT(row, 0); b += x[row] * AT(row, 1); c += x[row] * AT(row, 2); d += x[row] * AT(row, 3);
        e += x[row + 1] * AT(row + 1, 0); f += x[row + 1] * AT(row + 1, 1);
        g += x[row + 1] * AT(row + 1, 2); h += x[row + 1] * AT(row + 1, 3);
    }
    for (; row < rows; row++) {
        a += x[row] * AT(row, 0); b += x[row] * AT(row, 1); c += x[row] * AT(row, 2); d += x[row] * AT(row, 3);
    }
    vector *sums = (vector *)y;
    sums[0] += a + e; sums[1] += b + f; sums[2] += c + g; sums[3] += d + h;
}

INLINE void two_vectors(const float *x, int rows, const float *w, int stride, float *y) {
    vector a = {0}, b = {0}, c = {0}, d = {0}, e = {0}, f = {0}, g = {0}, h = {0};
    int row = 0;
    for (; row + 4 <= rows; row += 4) {
        a += x[row] * AT(row, 0); b += x[row] * AT(row, 1);
        c += x[row + 1] * AT(row + 1, 0); d += x[row + 1] * AT(row + 1, 1);
        e += x[row + 2] * AT(row + 2, 0); f += x[row + 2] * AT(row + 2, 1);
        g += x[row + 3] * AT(row + 3, 0); h += x[row + 3] * AT(row + 3, 1);
    }
    for (; row < rows; row++) {
        a += x[row] * AT(row, 0); b += x[row] * AT(row, 1);
    }
    vector *sums = (vector *)y;
    sums[0] += (a + c) + (e + g); sums[1] += (b + d) + (f + h);
}

INLINE void one_vector(const float *x, int rows, const float *w, int stride, float *y) {
    vector a = {0}, b = {0}, c = {0}, d = {0};
    int row = 0;
    for (; row + 4 <= rows; row += 4) {
        a += x[row] * AT(row, 0); b += x[row + 1] * AT(row + 1, 0);
        c += x[row + 2] * AT(row + 2, 0); d += x[row + 3] * AT(row + 3, 0);
    }
    for (; row < rows; row++) a += x[row] * AT(row, 0);
    *(vector *)y += (a + b) + (c + d);
}

/* y (columns) += x (rows) times w (rows, columns), whose rows are padded with zeros to whole vectors, as y is. */
INLINE void multiply_add(const float *x, int rows, const float *w, int columns, float *y) {
    const int count = VECTORS(columns), stride = PADDED(columns);
    int v = 0;
    for (; v + 4 <= count; v += 4) four_vectors(x, rows, w + v * LANES, stride, y + v * LANES);
    for (; v + 2 <= count; v += 2) two_vectors(x, rows, w + v * LANES, stride, y + v * LANES);
    for (; v < count; v++) one_vector(x, rows, w + v * LANES, stride, y + v * LANES);
}

/* tanh by the quotient of polynomials that Eigen uses, to some units of the last place. */
INLINE float tanh_of(float x) {
    const float edge = 7.90531110763549805f;
    x = x > edge ? edge : x;
    x = x < -edge ? -edge : x;
    const float s = x * x;
    float p = -2.76076847742355e-16f;
    p = p * s + 2.00018790482477e-13f;
    p = p * s - 8.60467152213735e-11f;
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

INLINE float between(float low, float x, float high) {
    x = x < low ? low : x;
    return x > high ? high : x;
}

/* A layer of gated units: from the sums of odd inputs (units, pairs, factors) and of even ones (gates, levels). */
INLINE void gate(int half, const float *restrict of_odd, const float *restrict of_even, float *restrict odd,
                 float *restrict even) {
    for (int i = 0; i < half; i++) odd[i] = tanh_of(of_odd[i]) * of_even[i];
    for (int i = 0; i < half; i++) even[i] = tanh_of(of_odd[half + i]) * of_odd[2 * half + i] + tanh_of(of_even[half + i]);
}

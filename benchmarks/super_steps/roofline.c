/* As many products of weights as a super step has, and nothing else: what a super step can take at least. */

/* `steps` times `blocks` of weights (8, LANES), each times one of `y` (LANES); the sums are left there. */
void products(const float *k, long blocks, long steps, float *y) {
    na_wide sums[8];
    for (int j = 0; j < 8; j++) NA_ZERO(sums[j]);
    for (long t = 0; t < steps; t++) {
        const na_wide *row = (const na_wide *)k;
        for (long q = 0; q < blocks; q++, row += 8)
            for (int j = 0; j < 8; j++) NA_MULTIPLY_ADD(sums[j], row[j], y[q % LANES]);
    }
    for (int j = 1; j < 8; j++) NA_ADD(sums[0], sums[j]);
    *(na_wide *)y = sums[0];
}

/* `steps` times `panels` of weights (LANES, LANES), each times x (LANES, LANES), for sixteen motions. */
void products_of_lanes(const float *k, const float *x, long panels, long steps, float *y) {
    for (long t = 0; t < steps; t++)
        for (long p = 0; p < panels; p++)
            na_lane_products(LANES, LANES, LANES, k + p * LANES * LANES, (const na_wide *)x, (na_wide *)y + p * LANES);
}

/* The same with weights and inputs of 16 bits, where the processor multiplies pairs of them and adds both products to a sum
   of 32 bits. A register holds 32 weights. */
#if defined(__AVX512BF16__) && defined(__AVX512VNNI__)
#include <immintrin.h>

typedef __m512i pairs_sum(__m512i sum, __m512i some, __m512i others);

static inline __m512i add_bfloat16(__m512i sum, __m512i some, __m512i others) {
    return _mm512_castps_si512(_mm512_dpbf16_ps(_mm512_castsi512_ps(sum), (__m512bh)some, (__m512bh)others));
}

static inline __m512i add_int16(__m512i sum, __m512i some, __m512i others) {
    return _mm512_dpwssd_epi32(sum, some, others);
}

static inline __attribute__((always_inline)) void pairs(pairs_sum add, const float *k, long blocks, long steps, float *y) {
    __m512i sums[8];
    for (int j = 0; j < 8; j++) sums[j] = _mm512_setzero_si512();
    for (long t = 0; t < steps; t++) {
        const float *row = k;
        for (long q = 0; q < blocks; q++)
            for (int j = 0; j < 8; j++, row += LANES)
                sums[j] = add(sums[j], _mm512_castps_si512(_mm512_set1_ps(y[q % LANES])), _mm512_loadu_si512(row));
    }
    for (int j = 1; j < 8; j++) sums[0] = _mm512_or_si512(sums[0], sums[j]);
    _mm512_storeu_si512(y, sums[0]);
}

static inline __attribute__((always_inline)) void pairs_of_lanes(pairs_sum add, const float *k, const float *x, long panels,
                                                                 long steps, float *y) {
    for (long t = 0; t < steps; t++)
        for (long p = 0; p < panels; p++) {
            const float *row = k + p * LANES * LANES;
            __m512i sums[LANES];
            for (int j = 0; j < LANES; j++) sums[j] = _mm512_setzero_si512();
            for (int q = 0; q < LANES; q++, row += LANES)
                for (int j = 0; j < LANES; j++)
                    sums[j] = add(sums[j], _mm512_loadu_si512(x + q * LANES), _mm512_castps_si512(_mm512_set1_ps(row[j])));
            for (int j = 0; j < LANES; j++) _mm512_storeu_si512(y + (p * LANES + j) * LANES, sums[j]);
        }
}

void products_bfloat16(const float *k, long blocks, long steps, float *y) { pairs(add_bfloat16, k, blocks, steps, y); }

void products_int16(const float *k, long blocks, long steps, float *y) { pairs(add_int16, k, blocks, steps, y); }

void products_of_lanes_bfloat16(const float *k, const float *x, long panels, long steps, float *y) {
    pairs_of_lanes(add_bfloat16, k, x, panels, steps, y);
}

void products_of_lanes_int16(const float *k, const float *x, long panels, long steps, float *y) {
    pairs_of_lanes(add_int16, k, x, panels, steps, y);
}
#endif

/* The same, with bfloat16 in tiles of (LANES, LANES) pairs, where Linux lets the process use them. */
#if defined(__AMX_BF16__) && defined(__AMX_TILE__) && defined(__linux__)
#include <sys/syscall.h>
#include <unistd.h>

enum { REQUEST_STATE = 0x1023, TILES = 18 }; /* of arch_prctl */

int has_tiles(void) { return syscall(SYS_arch_prctl, REQUEST_STATE, TILES) == 0; }

void products_of_lanes_tiles(const float *k, const float *x, long panels, long steps, float *y) {
    struct {
        unsigned char palette, row, none[14];
        unsigned short bytes[16];
        unsigned char rows[16];
    } sizes = {.palette = 1};
    for (int tile = 0; tile < 8; tile++) {
        sizes.bytes[tile] = 4 * LANES;
        sizes.rows[tile] = LANES;
    }
    _tile_loadconfig(&sizes);
    _tile_loadd(0, x, 4 * LANES);
    for (long t = 0; t < steps; t++)
        for (long p = 0; p < panels; p++) {
            _tile_zero(1);
            _tile_loadd(2, k + p * LANES * LANES, 4 * LANES);
            _tile_dpbf16ps(1, 0, 2);
            _tile_stored(1, y + p * LANES * LANES, 4 * LANES);
        }
    _tile_release();
}
#endif
